// bake/image.cpp: reading and writing pictures through OpenImageIO, and atomic file output.
#include "image.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <memory>
#include <mutex>
#include <set>

#include <fcntl.h>
#include <unistd.h>

#include <OpenImageIO/imageio.h>

#include "error.hpp"

namespace selvedge
{

namespace
{

constexpr int side_limit = 32768;
constexpr std::int64_t pixel_limit = std::int64_t(1) << 28;

float linear_from_srgb(float v) // IEC 61966-2-1
{
    return v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f);
}

std::string one_line(std::string text)
{
    for (char& c : text)
        if (c == '\n' || c == '\r') c = ' ';
    while (!text.empty() && text.back() == ' ') text.pop_back();
    return text;
}

void require_regular_file(const std::string& path)
{
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) throw InputError(path, 0, "no such file");
    if (std::filesystem::is_directory(status)) throw InputError(path, 0, "is a folder, expected a file");
}

// The PNG library prints its own complaint about a cut file, the JPEG library fills it up with grey: looked at here.
void refuse_cut_file(const std::string& path)
{
    std::FILE* file = std::fopen(path.c_str(), "rb");
    if (!file) throw InputError(path, 0, "cannot be read: %s", std::strerror(errno));
    char head[8] = {}, tail[4096];
    const std::size_t head_size = std::fread(head, 1, sizeof head, file);
    std::fseek(file, 0, SEEK_END);
    const long size = std::ftell(file);
    std::fseek(file, std::max(0L, size - static_cast<long>(sizeof tail)), SEEK_SET);
    const std::string end(tail, std::fread(tail, 1, sizeof tail, file));
    std::fclose(file);
    const bool png = head_size == 8 && std::memcmp(head, "\x89PNG\r\n\x1a\n", 8) == 0;
    const bool jpeg = head_size >= 3 && std::memcmp(head, "\xff\xd8\xff", 3) == 0;
    if ((png && end.find("IEND") == std::string::npos) || (jpeg && end.find("\xff\xd9") == std::string::npos))
        throw InputError(path, 0, "truncated picture: the end of the %s is missing", png ? "PNG" : "JPEG");
}

// A file that has no name until it is whole (O_TMPFILE, Linux 3.11), so that a program that is killed leaves nothing
// half written; where the folder's file system knows no such thing, PATH.tmp-PID.
class Draft
{
  public:
    explicit Draft(const std::string& path) : target_(path), beside_(path + ".tmp-" + std::to_string(::getpid()))
    {
        std::string folder = std::filesystem::path(path).parent_path().string();
        if (folder.empty()) folder = ".";
        remove_leftovers(folder, std::filesystem::path(path).filename().string() + ".tmp-");
        descriptor_ = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0666);
    }
    ~Draft()
    {
        if (descriptor_ >= 0)
            ::close(descriptor_);
        else
            std::remove(beside_.c_str());
    }
    Draft(const Draft&) = delete;
    Draft& operator=(const Draft&) = delete;

    // What a writer opens by name.
    std::string path() const { return descriptor_ >= 0 ? "/proc/self/fd/" + std::to_string(descriptor_) : beside_; }
    // Puts the finished file in the place of the target. A file cannot be linked over another one; then it gets its
    // temporary name for the blink of an eye.
    void finish()
    {
        if (descriptor_ >= 0 && ::linkat(AT_FDCWD, path().c_str(), AT_FDCWD, target_.c_str(), AT_SYMLINK_FOLLOW) == 0)
            return;
        const bool named =
            descriptor_ < 0 || ::linkat(AT_FDCWD, path().c_str(), AT_FDCWD, beside_.c_str(), AT_SYMLINK_FOLLOW) == 0;
        if (named && std::rename(beside_.c_str(), target_.c_str()) == 0) return;
        const std::string reason = std::strerror(errno);
        std::remove(beside_.c_str());
        throw InputError(target_, 0, "cannot be written: %s", reason.c_str());
    }

  private:
    // What processes that are no more have left under temporary names, at the first write to a target.
    static void remove_leftovers(const std::string& folder, const std::string& prefix)
    {
        static std::mutex guard;
        static std::set<std::string> seen;
        const std::lock_guard<std::mutex> lock(guard);
        if (!seen.insert(folder + "/" + prefix).second) return;
        std::error_code error;
        for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
            const std::string name = entry.path().filename().string();
            if (name.rfind(prefix, 0) != 0) continue;
            const pid_t owner = pid_t(std::strtol(name.c_str() + prefix.size(), nullptr, 10));
            if (owner > 0 && ::kill(owner, 0) != 0 && errno == ESRCH) std::filesystem::remove(entry.path(), error);
        }
    }

    std::string target_, beside_;
    int descriptor_ = -1;
};

void require_folder_of(const std::string& path)
{
    const auto folder = std::filesystem::path(path).parent_path();
    std::error_code error;
    if (!folder.empty() && !std::filesystem::is_directory(folder, error))
        throw InputError(path, 0, "cannot be written: no folder %s", folder.c_str());
}

void write_picture(const std::string& path, const char* format, const OIIO::ImageSpec& spec, OIIO::TypeDesc type,
                   const void* pixels)
{
    require_folder_of(path);
    Draft draft(path);
    {
        // create() picks the format by extension; the temporary name has another one.
        auto output = OIIO::ImageOutput::create(format);
        if (!output) throw InputError(path, 0, "no writer for %s: %s", format, one_line(OIIO::geterror()).c_str());
        if (!output->open(draft.path(), spec) || !output->write_image(type, pixels) || !output->close()) {
            const std::string reason = one_line(output->geterror());
            throw InputError(path, 0, "cannot be written: %s", reason.c_str());
        }
    }
    draft.finish();
}

} // namespace

Image::Image(int w, int h, std::vector<std::string> names) : width(w), height(h), channels(std::move(names))
{
    pixels.assign(static_cast<std::size_t>(w) * static_cast<std::size_t>(h) * channels.size(), 0.0f);
}

int Image::channel(const std::string& name) const
{
    const auto found = std::find(channels.begin(), channels.end(), name);
    return found == channels.end() ? -1 : static_cast<int>(found - channels.begin());
}

Image read_image(const std::string& path)
{
    require_regular_file(path);
    refuse_cut_file(path);
    auto input = OIIO::ImageInput::open(path);
    if (!input)
        throw InputError(path, 0, "%s, expected a picture (EXR, HDR, PNG, JPEG, TIFF)",
                         one_line(OIIO::geterror()).c_str());
    const OIIO::ImageSpec spec = input->spec();
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.width > side_limit ||
        spec.height > side_limit || std::int64_t(spec.width) * spec.height * spec.nchannels > 4 * pixel_limit)
        throw InputError(path, 0, "picture of %d x %d x %d, expected at most %d on a side", spec.width, spec.height,
                         spec.nchannels, side_limit);

    Image image(spec.width, spec.height, spec.channelnames);
    if (!input->read_image(0, 0, 0, spec.nchannels, OIIO::TypeDesc::FLOAT, image.pixels.data()))
        throw InputError(path, 0, "truncated or damaged picture: %s", one_line(input->geterror()).c_str());
    if (input->has_error()) throw InputError(path, 0, "damaged picture: %s", one_line(input->geterror()).c_str());

    if (!spec.format.is_floating_point()) {
        const int alpha = spec.alpha_channel;
        const std::size_t count = image.channels.size();
        for (std::size_t i = 0; i < image.pixels.size(); ++i)
            if (static_cast<int>(i % count) != alpha) image.pixels[i] = linear_from_srgb(image.pixels[i]);
    }
    for (const auto& attribute : spec.extra_attribs)
        if (attribute.type() == OIIO::TypeDesc::STRING)
            image.metadata[attribute.name().string()] = attribute.get_string();
    return image;
}

ImageMetadata read_metadata(const std::string& path)
{
    require_regular_file(path);
    const auto input = OIIO::ImageInput::open(path);
    if (!input)
        throw InputError(path, 0, "%s, expected a picture (EXR, HDR, PNG, JPEG, TIFF)",
                         one_line(OIIO::geterror()).c_str());
    ImageMetadata metadata;
    for (const auto& attribute : input->spec().extra_attribs)
        if (attribute.type() == OIIO::TypeDesc::STRING) metadata[attribute.name().string()] = attribute.get_string();
    return metadata;
}

void write_exr(const std::string& path, const Image& image, const ImageMetadata& metadata, ExrType type)
{
    const auto storage = type == ExrType::float16 ? OIIO::TypeDesc::HALF : OIIO::TypeDesc::FLOAT;
    OIIO::ImageSpec spec(image.width, image.height, image.channel_count(), storage);
    spec.channelnames = image.channels;
    spec.alpha_channel = image.channel("A");
    spec.attribute("compression", "zip");
    spec.attribute("oiio:ColorSpace", "Linear");
    ImageMetadata all = image.metadata;
    for (const auto& [key, value] : metadata) all[key] = value;
    for (const auto& [key, value] : all) spec.attribute(key, value);
    write_picture(path, "exr", spec, OIIO::TypeDesc::FLOAT, image.pixels.data());
}

void write_png(const std::string& path, const Image& image)
{
    const int source = image.channel_count();
    const int count = source >= 4 && image.channels[3] == "A" ? 4 : source >= 3 ? 3 : 1;
    std::vector<unsigned char> bytes;
    bytes.reserve(static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height) *
                  static_cast<std::size_t>(count));
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x)
            for (int c = 0; c < count; ++c) {
                const float value = image.at(x, y)[c];
                const float safe = value > 0 ? std::min(value, 1.0f) : 0.0f; // NaN fails the comparison
                bytes.push_back(static_cast<unsigned char>(std::lround(safe * 255.0f)));
            }
    OIIO::ImageSpec spec(image.width, image.height, count, OIIO::TypeDesc::UINT8);
    spec.attribute("oiio:ColorSpace", "sRGB");
    for (const auto& [key, value] : image.metadata) spec.attribute(key, value);
    write_picture(path, "png", spec, OIIO::TypeDesc::UINT8, bytes.data());
}

void write_file(const std::string& path, const void* bytes, std::size_t size)
{
    require_folder_of(path);
    Draft draft(path);
    std::FILE* file = std::fopen(draft.path().c_str(), "wb");
    if (!file) throw InputError(path, 0, "cannot be written: %s", std::strerror(errno));
    const bool written = std::fwrite(bytes, 1, size, file) == size;
    const bool closed = std::fclose(file) == 0;
    if (!written || !closed) {
        const std::string reason = std::strerror(errno);
        throw InputError(path, 0, "cannot be written: %s", reason.c_str());
    }
    draft.finish();
}

std::map<std::string, std::string> image_library_versions()
{
    return {{"OpenImageIO", format_text("%d.%d.%d", OIIO_VERSION_MAJOR, OIIO_VERSION_MINOR, OIIO_VERSION_PATCH)}};
}

std::string read_file(const std::string& path, std::size_t limit)
{
    require_regular_file(path);
    std::FILE* file = std::fopen(path.c_str(), "rb");
    if (!file) throw InputError(path, 0, "cannot be read: %s", std::strerror(errno));
    std::string bytes;
    char block[1 << 16];
    std::size_t got = 0;
    while ((got = std::fread(block, 1, sizeof block, file)) > 0 && bytes.size() <= limit) bytes.append(block, got);
    const bool failed = std::ferror(file) != 0;
    std::fclose(file);
    if (failed) throw InputError(path, 0, "cannot be read: %s", std::strerror(errno));
    if (bytes.size() > limit) throw InputError(path, 0, "file of more than %zu bytes, expected less", limit);
    return bytes;
}

} // namespace selvedge
