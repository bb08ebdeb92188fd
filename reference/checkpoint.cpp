// Checkpoint files: magic, owner text, counters, sums, checksum; in the machine's own byte order.
#include "reference/checkpoint.hpp"

#include <cstring>
#include <filesystem>
#include <type_traits>

#include "bake/error.hpp"
#include "bake/image.hpp"

namespace selvedge
{

namespace
{

constexpr char magic[8] = {'S', 'L', 'V', 'C', 'K', 'P', 'T', '2'};

static_assert(sizeof(PixelSums) == 16 * sizeof(double) && std::is_trivially_copyable_v<PixelSums>);
static_assert(sizeof(TileState) == 16 && std::is_trivially_copyable_v<TileState>);

std::uint64_t checksum(const std::string& bytes, std::size_t size)
{
    std::uint64_t hash = 0x243f6a8885a308d3u;
    for (std::size_t at = 0; at + 8 <= size; at += 8) {
        std::uint64_t word;
        std::memcpy(&word, bytes.data() + at, 8);
        hash = (hash ^ word) * 0x9e3779b97f4a7c15u;
        hash ^= hash >> 32;
    }
    for (std::size_t at = size & ~std::size_t(7); at < size; ++at)
        hash = (hash ^ static_cast<unsigned char>(bytes[at])) * 0x9e3779b97f4a7c15u;
    return hash ^ (hash >> 29);
}

template <class T> void put(std::string& bytes, const T& value)
{
    bytes.append(reinterpret_cast<const char*>(&value), sizeof(T));
}

template <class T> void put_all(std::string& bytes, const std::vector<T>& values)
{
    put(bytes, std::uint64_t(values.size()));
    bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

class Reader
{
  public:
    Reader(const std::string& path, const std::string& bytes, std::size_t end) : path_(path), bytes_(bytes), end_(end)
    {
    }
    template <class T> T take()
    {
        T value;
        std::memcpy(&value, place(sizeof(T)), sizeof(T));
        return value;
    }
    template <class T> std::vector<T> take_all()
    {
        const std::uint64_t count = take<std::uint64_t>();
        if (count > (end_ - at_) / sizeof(T)) damaged();
        std::vector<T> values(count);
        if (count > 0) std::memcpy(values.data(), place(count * sizeof(T)), count * sizeof(T));
        return values;
    }
    [[noreturn]] void damaged() const
    {
        throw InputError(path_, 0, "found a damaged checkpoint, expected a whole one (remove it to start anew)");
    }

  private:
    const char* place(std::size_t size)
    {
        if (size > end_ - at_) damaged();
        at_ += size;
        return bytes_.data() + at_ - size;
    }
    const std::string& path_;
    const std::string& bytes_;
    std::size_t end_, at_ = 0;
};

} // namespace

std::string checkpoint_owner(const Scene& scene, const RenderSettings& settings)
{
    return format_text("scene %s, %s, max depth %d, MIS %d, seed %u, %d x %d, region %d,%d,%d,%d, aovs %u, target "
                       "error %.9g, model %s",
                       scene.hash.c_str(), settings.integrator == Integrator::direct ? "direct" : "path",
                       settings.max_depth, int(settings.mis), settings.seed, settings.resolution.x,
                       settings.resolution.y, settings.region.x, settings.region.y, settings.region.z,
                       settings.region.w, settings.aovs, settings.target_error, model_json(scene.model).dump().c_str());
}

void write_checkpoint(const std::string& path, const std::string& owner, const Checkpoint& checkpoint)
{
    const RenderState& state = checkpoint.state;
    std::string bytes(magic, sizeof(magic));
    bytes.reserve(4096 + state.pixels.size() * sizeof(PixelSums) + state.aovs.size() * sizeof(double));
    put_all(bytes, std::vector<char>(owner.begin(), owner.end()));
    put(bytes, checkpoint.block_length);
    put(bytes, checkpoint.seconds);
    for (const std::uint64_t count :
         {state.samples, state.rays, state.shadow_rays, state.rays_saved, state.bad_samples, state.skipped})
        put(bytes, count);
    put_all(bytes, state.pixels);
    put_all(bytes, state.aovs);
    put_all(bytes, state.tiles);
    put_all(bytes, state.kept);
    for (const double pilot : state.pilot) put(bytes, pilot);
    put(bytes, checksum(bytes, bytes.size()));
    write_file(path, bytes.data(), bytes.size());
}

std::optional<Checkpoint> read_checkpoint(const std::string& path, const std::string& owner)
{
    std::error_code code;
    if (!std::filesystem::exists(path, code)) return std::nullopt;
    const std::string bytes = read_file(path, std::size_t(1) << 36);
    if (bytes.size() < sizeof(magic) + 8 || std::memcmp(bytes.data(), magic, sizeof(magic)) != 0)
        throw InputError(path, 0, "found another kind of file, expected a checkpoint (remove it to start anew)");
    const std::size_t end = bytes.size() - 8;
    std::uint64_t stored;
    std::memcpy(&stored, bytes.data() + end, 8);
    Reader reader(path, bytes, end);
    if (stored != checksum(bytes, end)) reader.damaged();
    reader.take<std::uint64_t>(); // magic
    const std::vector<char> found = reader.take_all<char>();
    if (std::string(found.begin(), found.end()) != owner)
        throw InputError(path, 0, "found a checkpoint of other work (%s), expected one of %s",
                         std::string(found.begin(), found.end()).c_str(), owner.c_str());
    Checkpoint checkpoint;
    checkpoint.block_length = reader.take<std::uint32_t>();
    checkpoint.seconds = reader.take<double>();
    RenderState& state = checkpoint.state;
    for (std::uint64_t* count :
         {&state.samples, &state.rays, &state.shadow_rays, &state.rays_saved, &state.bad_samples, &state.skipped})
        *count = reader.take<std::uint64_t>();
    state.pixels = reader.take_all<PixelSums>();
    state.aovs = reader.take_all<double>();
    state.tiles = reader.take_all<TileState>();
    state.kept = reader.take_all<glm::dvec3>();
    for (double& pilot : state.pilot) pilot = reader.take<double>();
    if (checkpoint.block_length == 0) reader.damaged();
    return checkpoint;
}

} // namespace selvedge
