// bake/image.hpp: pictures in memory, EXR and PNG files. image.cpp is the only file that includes the image library.
#pragma once

#include <map>
#include <string>
#include <vector>

namespace selvedge
{

// A picture: float channels, scene-linear Rec.709 where the channels are colours. Row 0 is the TOP row.
struct Image {
    int width = 0, height = 0;
    std::vector<std::string> channels;           // "R", "G", "B", "A", "variance.R", ... in storage order
    std::vector<float> pixels;                   // width * height * channels, channel fastest, then x, then y
    std::map<std::string, std::string> metadata; // text attributes of the file, as read

    Image() = default;
    Image(int width, int height, std::vector<std::string> channels); // filled with 0

    int channel_count() const { return static_cast<int>(channels.size()); }
    int channel(const std::string& name) const; // index, -1 where there is none
    float* at(int x, int y) { return pixels.data() + offset(x, y); }
    const float* at(int x, int y) const { return pixels.data() + offset(x, y); }

  private:
    std::size_t offset(int x, int y) const
    {
        return (static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)) *
               channels.size();
    }
};

using ImageMetadata = std::map<std::string, std::string>;

enum class ExrType { float32, float16 };

// Any format OpenImageIO reads. Integer formats (PNG, JPEG, 8-bit TIFF) are taken as sRGB and made linear (alpha is
// not touched); float formats are taken as linear. A picture with one channel keeps the name the file gives it.
//   throws  InputError: missing, not a picture, truncated, larger than 32768 in either direction or 2^28 pixels
Image read_image(const std::string& path);

// The text attributes alone. throws InputError as read_image, but for damage behind the header
ImageMetadata read_metadata(const std::string& path);

// ZIP-compressed scanline EXR, channels named as in the image, `metadata` as text attributes (image.metadata too).
// Written to a file without a name, which is given one when it is whole: the file at `path` is whole or not touched,
// and a killed program leaves nothing behind. Folders that know no such files get PATH.tmp-PID, renamed at the end.
//   throws  InputError where the folder does not exist or the disk is full
void write_exr(const std::string& path, const Image& image, const ImageMetadata& metadata = {},
               ExrType type = ExrType::float32);

// 8-bit PNG of the first 3 channels (1 channel: grey; 4 with alpha: RGBA). Values are display-referred: [0, 1] as they
// are, clamped, NaN as 0; apply the display transform before. Whole or not touched, as write_exr.
void write_png(const std::string& path, const Image& image);

// The same atomic write for any other bytes (JSON reports, caches, drafts).
void write_file(const std::string& path, const void* bytes, std::size_t size);
// Whole file as bytes. throws InputError: missing, a folder, unreadable, larger than `limit` bytes
std::string read_file(const std::string& path, std::size_t limit = std::size_t(1) << 30);

// Name and version of the image library and of its formats' libraries, for --version.
std::map<std::string, std::string> image_library_versions();

} // namespace selvedge
