// EXR and PNG of finished pictures.
#include "reference/film.hpp"

#include <cmath>
#include <filesystem>
#include <limits>

#include "bake/error.hpp"

namespace selvedge
{

namespace
{

std::string lower_extension(const std::string& path)
{
    std::string extension = std::filesystem::path(path).extension().string();
    for (char& c : extension) c = char(std::tolower(static_cast<unsigned char>(c)));
    return extension;
}

} // namespace

RenderResult::RenderResult(int width_, int height_) : width(width_), height(height_)
{
    const std::size_t count = std::size_t(width_) * std::size_t(height_);
    mean.assign(count, glm::vec3(0.0f));
    variance.assign(count, glm::vec3(0.0f));
    alpha.assign(count, 0.0f);
    samples.assign(count, 0);
}

Image result_image(const RenderResult& result)
{
    std::vector<std::string> channels = {"R", "G", "B", "A", "variance.R", "variance.G", "variance.B", "samples"};
    for (const ResultLayer& layer : result.layers)
        channels.insert(channels.end(), layer.channels.begin(), layer.channels.end());
    Image image(result.width, result.height, channels);
    std::size_t at = 0;
    for (int y = 0; y < result.height; ++y)
        for (int x = 0; x < result.width; ++x, ++at) {
            float* out = image.at(x, y);
            for (int c = 0; c < 3; ++c) {
                out[c] = result.mean[at][c];
                out[4 + c] = result.variance[at][c];
            }
            out[3] = result.alpha.empty() ? 1.0f : result.alpha[at];
            out[7] = float(result.samples[at]);
            out += 8;
            for (const ResultLayer& layer : result.layers) {
                const std::size_t count = layer.channels.size();
                for (std::size_t c = 0; c < count; ++c) *out++ = layer.values[at * count + c];
            }
        }
    return image;
}

Image display_image(const RenderResult& result, float exposure, const DisplayTransform& display)
{
    Image image(result.width, result.height, {"R", "G", "B"});
    for (std::size_t at = 0; at < result.mean.size(); ++at)
        for (int c = 0; c < 3; ++c) image.pixels[3 * at + std::size_t(c)] = result.mean[at][c];
    display.apply(image.pixels.data(), result.mean.size(), exposure);
    return image;
}

void check_result_path(const std::string& path)
{
    const std::string extension = lower_extension(path);
    if (extension != ".exr" && extension != ".png")
        throw UsageError("-o %s: found the ending \"%s\", expected .exr or .png", path.c_str(), extension.c_str());
    std::error_code code;
    std::filesystem::path folder = std::filesystem::path(path).parent_path();
    if (folder.empty()) folder = ".";
    if (!std::filesystem::is_directory(folder, code))
        throw InputError(path, 0, "found no folder %s to write it into", folder.c_str());
    if (std::filesystem::is_directory(path, code))
        throw InputError(path, 0, "found a folder, expected a file to write");
    if (extension == ".png") DisplayTransform::of_environment();
}

void write_result(const std::string& path, const RenderResult& result, float exposure, const ImageMetadata& metadata)
{
    check_result_path(path);
    if (lower_extension(path) == ".png") {
        const DisplayTransform display = DisplayTransform::of_environment();
        Image image = display_image(result, exposure, display);
        image.metadata = metadata;
        image.metadata["selvedge:display"] = display.name();
        write_png(path, image);
    } else
        write_exr(path, result_image(result), metadata);
}

glm::dvec3 block_variance(glm::dvec3 total, glm::dvec3 squares, double blocks, std::uint32_t block_length)
{
    if (blocks < 2.0) return glm::dvec3(0.0);
    // sum (m_b - mean)^2 / (n - 1), with the mean of the complete blocks
    const double length = double(block_length);
    return glm::max(squares - total * total / blocks, glm::dvec3(0.0)) / (length * length * (blocks - 1.0));
}

PixelEstimate estimate(const PixelSums& sums, std::uint64_t samples, std::uint32_t block_length)
{
    PixelEstimate result;
    if (samples == 0) return result;
    const glm::dvec3 total = sums.total[0] + sums.total[1];
    result.mean = (total + sums.block) / double(samples);
    const double blocks = double(samples / block_length);
    if (blocks >= 2.0)
        result.variance = block_variance(total, sums.squares[0] + sums.squares[1], blocks, block_length) / blocks;
    return result;
}

double error_estimate(const RenderResult& result)
{
    double sum = 0.0;
    std::size_t count = 0;
    for (std::size_t i = 0; i < result.mean.size(); ++i) {
        if (result.samples[i] == 0) continue;
        for (int c = 0; c < 3; ++c) {
            const double mean = double(result.mean[i][c]);
            sum += double(result.variance[i][c]) / (mean * mean + 0.01);
        }
        count += 3;
    }
    return count > 0 ? sum / double(count) : std::numeric_limits<double>::quiet_NaN();
}

} // namespace selvedge
