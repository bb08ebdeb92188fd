// bake/cache.cpp: hashing, reading and writing of baked fabrics.
#include "cache.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>
#include <string_view>
#include <type_traits>

#include "error.hpp"
#include "image.hpp"

namespace selvedge
{

namespace
{

// Raise it when the words of a bake change for the same inputs.
constexpr std::uint32_t format_version = 6;
constexpr char magic[8] = {'s', 'e', 'l', 'v', 'b', 'a', 'k', 'e'};
constexpr std::uint32_t warning_limit = 1000;

struct Header {
    char magic[8];
    std::uint32_t version;
    std::int32_t part;
    std::int32_t width, height;
    std::uint64_t payload_bytes;
    std::uint64_t check[2]; // hash of the payload
};

__extension__ using Wide = unsigned __int128;

// Values to bytes and back; a reader that runs out of bytes says so and goes on with zeros.
class Writer
{
  public:
    template <class T> void value(const T& item) { bytes.append(reinterpret_cast<const char*>(&item), sizeof item); }
    template <class T> void array(const std::vector<T>& items)
    {
        value(std::uint64_t(items.size()));
        bytes.append(reinterpret_cast<const char*>(items.data()), items.size() * sizeof(T));
    }
    void text(const std::string& item) { array(std::vector<char>(item.begin(), item.end())); }
    std::string bytes;
};

class Reader
{
  public:
    explicit Reader(std::string_view from) : left(from) {}
    template <class T> void value(T& item)
    {
        item = T{};
        whole = whole && left.size() >= sizeof item;
        if (!whole) return;
        std::memcpy(&item, left.data(), sizeof item);
        left.remove_prefix(sizeof item);
    }
    template <class T> void array(std::vector<T>& items)
    {
        std::uint64_t count = 0;
        value(count);
        whole = whole && count <= left.size() / sizeof(T);
        items.resize(whole ? count : 0);
        if (items.empty()) return;
        std::memcpy(items.data(), left.data(), items.size() * sizeof(T));
        left.remove_prefix(items.size() * sizeof(T));
    }
    void text(std::string& item)
    {
        std::vector<char> letters;
        array(letters);
        item.assign(letters.begin(), letters.end());
    }
    bool done() const { return whole && left.empty(); }

  private:
    std::string_view left;
    bool whole = true;
};

// One description of the files for both ways: Packed and Warnings are const where they are written.
template <class Archive, class Packed, class Warnings>
void pass(Archive& archive, CachePart part, Packed& fabric, Warnings& warnings)
{
    for (auto& side : fabric.side) {
        if (part == CachePart::maps) archive.array(side.slope_mips);
        if (&side == &fabric.side[1] && fabric.back_shift) continue; // the front's
        if (part == CachePart::visibility) {
            archive.array(side.words);
            archive.array(side.asg);
            continue;
        }
        archive.array(side.texels);
        archive.array(side.horizons);
        archive.array(side.heights);
        archive.value(side.height_range_m);
    }
    if (part == CachePart::visibility) return;
    archive.value(fabric.tile_m);
    archive.value(fabric.has_gaps);
    archive.value(fabric.warp_cover);
    archive.value(fabric.weft_cover);
    archive.value(fabric.gap_cover);
    archive.array(fabric.stacks);
    std::uint32_t count = static_cast<std::uint32_t>(warnings.size());
    archive.value(count);
    if constexpr (!std::is_const_v<Warnings>) warnings.resize(std::min(count, warning_limit));
    for (auto& warning : warnings) archive.text(warning);
}

// Whether what was read has the sizes that the maps' size asks for.
bool fits(CachePart part, const PackedFabric& fabric)
{
    const std::size_t texels = static_cast<std::size_t>(fabric.size.x) * static_cast<std::size_t>(fabric.size.y);
    const bool asg = fabric.visibility == VisibilityKind::asg || fabric.visibility == VisibilityKind::asg_lsq;
    const std::size_t words = fabric.visibility == VisibilityKind::horizon16 ? texels / 2
                              : fabric.visibility == VisibilityKind::cap     ? texels
                                                                             : 0;
    bool whole = true;
    for (const PackedSide& side : fabric.side) {
        whole = whole && (part == CachePart::visibility ||
                          side.slope_mips.size() == slope_level_offset(fabric.size, slope_level_count(fabric.size)));
        if (&side == &fabric.side[1] && fabric.back_shift) continue;
        whole = whole &&
                (part == CachePart::visibility ? side.words.size() == words && side.asg.size() == (asg ? 2 * texels : 0)
                                               : side.texels.size() == texels && side.horizons.size() * 4 == texels &&
                                                     side.heights.size() == texels);
    }
    return whole;
}

std::string path_of(CachePart part, const std::string& hash, const PackedFabric& fabric)
{
    return cache_folder() + "/" + hash +
           (part == CachePart::maps ? ".maps" : std::string(".") + visibility_name(fabric.visibility));
}

} // namespace

void ContentHash::bytes(const void* data, std::size_t size)
{
    Wide hash = static_cast<Wide>(high) << 64 | low;
    const Wide prime = static_cast<Wide>(0x0000000001000000u) << 64 | 0x13bu;
    const auto* byte = static_cast<const unsigned char*>(data);
    for (std::size_t i = 0; i < size; ++i) {
        hash ^= byte[i];
        hash *= prime;
    }
    high = static_cast<std::uint64_t>(hash >> 64);
    low = static_cast<std::uint64_t>(hash);
}

void ContentHash::text(const std::string& value)
{
    number(static_cast<std::int64_t>(value.size()));
    bytes(value.data(), value.size());
}

std::string ContentHash::hex() const
{
    return format_text("%016llx%016llx", static_cast<unsigned long long>(high), static_cast<unsigned long long>(low));
}

std::string geometry_hash(const Fabric& fabric, const WovenPlan& plan)
{
    ContentHash hash;
    hash.number(std::int64_t(format_version));
    hash.number(std::int64_t(plan.size.x));
    hash.number(std::int64_t(plan.size.y));
    hash.bytes(plan.repeat.warp_up.data(), plan.repeat.warp_up.size());
    for (const auto* types : {&plan.end_type, &plan.pick_type}) {
        hash.number(std::int64_t(types->size()));
        hash.bytes(types->data(), types->size() * sizeof(int));
    }
    for (const auto* lengths : {&plan.end_spacing_m, &plan.pick_spacing_m, &plan.end_width_m, &plan.pick_width_m})
        hash.bytes(lengths->data(), lengths->size() * sizeof(float));
    for (const YarnSpec* yarn : {&fabric.warp, &fabric.weft}) {
        hash.number(yarn->aspect);
        hash.number(std::int64_t(yarn->section));
        hash.number(yarn->crimp.value_or(-1.0f));
    }
    for (const int value : {plan.warp_plies, plan.weft_plies, plan.warp_turns, plan.weft_turns})
        hash.number(std::int64_t(value));
    return hash.hex();
}

std::string geometry_hash(const Fabric& fabric, const KnitPlan& plan)
{
    ContentHash hash;
    hash.text("knit");
    for (const int value : {static_cast<int>(format_version), plan.size.x, plan.size.y, plan.pattern.columns,
                            plan.pattern.rows, plan.pattern.rows_per_course, plan.across, plan.up, plan.plies})
        hash.number(std::int64_t(value));
    for (const KnitLoop& loop : plan.pattern.loops) {
        for (const int value : {loop.row, loop.column, loop.face, loop.bed, loop.level, loop.strand})
            hash.number(std::int64_t(value));
        hash.number(std::int64_t(loop.parents.size()));
        hash.bytes(loop.parents.data(), loop.parents.size() * sizeof(KnitParent));
    }
    for (const float value : {plan.wale_m, plan.row_m, plan.loop_m, plan.width_m, fabric.weft.aspect,
                              plan.plies > 1 ? fabric.weft.ply_twist_deg : 0.0f})
        hash.number(value);
    return hash.hex();
}

std::string cache_folder()
{
    const auto variable = [](const char* name) {
        const char* value = std::getenv(name);
        return std::string(value ? value : "");
    };
    if (const std::string own = variable("SELVEDGE_CACHE"); !own.empty()) return own;
    if (const std::string xdg = variable("XDG_CACHE_HOME"); !xdg.empty()) return xdg + "/selvedge";
    if (const std::string home = variable("HOME"); !home.empty()) return home + "/.cache/selvedge";
    return "/tmp/selvedge-cache";
}

bool read_cache(CachePart part, const std::string& hash, PackedFabric& fabric, std::vector<std::string>& warnings,
                std::size_t& disk_bytes)
try {
    const std::string path = path_of(part, hash, fabric);
    std::error_code error;
    if (!std::filesystem::exists(path, error)) return false;
    const std::string bytes = read_file(path);
    Header header;
    if (bytes.size() < sizeof header) return false;
    std::memcpy(&header, bytes.data(), sizeof header);
    const std::string_view payload = std::string_view(bytes).substr(sizeof header);
    if (std::memcmp(header.magic, magic, sizeof magic) != 0 || header.version != format_version ||
        header.part != static_cast<std::int32_t>(part) || header.payload_bytes != payload.size() ||
        header.width != fabric.size.x || header.height != fabric.size.y)
        return false;
    ContentHash check;
    check.bytes(payload.data(), payload.size());
    if (check.words() != std::array{header.check[0], header.check[1]}) return false;

    PackedFabric found = fabric;
    std::vector<std::string> found_warnings;
    Reader reader(payload);
    pass(reader, part, found, found_warnings);
    if (!reader.done() || !fits(part, found)) return false;
    fabric = std::move(found);
    warnings.insert(warnings.end(), found_warnings.begin(), found_warnings.end());
    disk_bytes += bytes.size();
    return true;
} catch (const std::exception&) {
    return false; // unreadable: as good as absent
}

std::size_t write_cache(CachePart part, const std::string& hash, const PackedFabric& fabric,
                        const std::vector<std::string>& warnings)
try {
    Writer writer;
    Header header{};
    writer.value(header); // its place
    pass(writer, part, fabric, warnings);
    std::memcpy(header.magic, magic, sizeof magic);
    header.version = format_version;
    header.part = static_cast<std::int32_t>(part);
    header.width = fabric.size.x, header.height = fabric.size.y;
    header.payload_bytes = writer.bytes.size() - sizeof header;
    ContentHash check;
    check.bytes(writer.bytes.data() + sizeof header, header.payload_bytes);
    header.check[0] = check.words()[0], header.check[1] = check.words()[1];
    std::memcpy(writer.bytes.data(), &header, sizeof header);

    std::filesystem::create_directories(cache_folder());
    write_file(path_of(part, hash, fabric), writer.bytes.data(), writer.bytes.size());
    return writer.bytes.size();
} catch (const std::exception&) {
    return 0; // a read-only home must not stop a render
}

} // namespace selvedge
