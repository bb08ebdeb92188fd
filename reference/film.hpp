// A finished picture with its error, and how it is written: EXR with layers and header, or PNG through the display
// transform. The reference and the preview write through it, so their files look alike.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "bake/display.hpp"
#include "bake/image.hpp"

namespace selvedge
{

// Further layers of a picture: one float per pixel and channel.
struct ResultLayer {
    std::vector<std::string> channels; // "normal.X", ...
    std::vector<float> values;         // pixel-major, row 0 at the top
};

// Row 0 is the top row. Vectors hold width * height values.
struct RenderResult {
    int width = 0, height = 0;
    std::vector<glm::vec3> mean;     // scene-linear radiance
    std::vector<glm::vec3> variance; // of `mean`, from the spread of complete blocks; 0 where there are fewer than two
    std::vector<float> alpha;        // share of samples that met a surface; empty: 1 everywhere
    std::vector<std::uint32_t> samples; // per pixel
    std::vector<ResultLayer> layers;

    RenderResult() = default;
    RenderResult(int width, int height); // zeros
};

// R, G, B, A, variance.R, variance.G, variance.B, samples, then the layers.
Image result_image(const RenderResult& result);

// Through the display transform; R, G, B in [0, 1].
Image display_image(const RenderResult& result, float exposure, const DisplayTransform& display);

// Writes `path`: .exr (float, everything) or .png (8 bits, exposed by `exposure` stops, through the display transform
// that the environment asks for). Whole or not touched.
//   throws  UsageError for another ending (check_result_path tells before the work is done); InputError as write_exr
void write_result(const std::string& path, const RenderResult& result, float exposure, const ImageMetadata& metadata);
void check_result_path(const std::string& path); // also: throws InputError where the folder does not exist
                                                 // or $OCIO names no configuration

// Sums of one pixel. Samples come in blocks of equal length; the spread of the block means is the error estimate, since
// samples inside a block are stratified against each other and blocks are not. Even and odd blocks are summed apart:
// each half is independent of the other, which adaptive sampling needs (integrator.hpp).
struct PixelSums {
    glm::dvec3 block{0.0};                                  // samples of the block that is not complete yet
    glm::dvec3 total[2] = {glm::dvec3(0), glm::dvec3(0)};   // of complete blocks, even and odd ones
    glm::dvec3 squares[2] = {glm::dvec3(0), glm::dvec3(0)}; // of complete blocks' sums
    double hits = 0.0;                                      // samples that met a surface

    // After the last sample of block `number`.
    void finish_block(std::uint64_t number)
    {
        total[number & 1] += block;
        squares[number & 1] += block * block;
        block = glm::dvec3(0.0);
    }
};

// Variance of a block's mean, from `blocks` complete blocks with the given sums; 0 where there are fewer than two.
glm::dvec3 block_variance(glm::dvec3 total, glm::dvec3 squares, double blocks, std::uint32_t block_length);

// Mean and variance of the mean after `samples` samples in blocks of `block_length`. Whole blocks only decide the
// variance; the samples of a block that is not complete count in the mean.
struct PixelEstimate {
    glm::dvec3 mean{0.0}, variance{0.0};
};
PixelEstimate estimate(const PixelSums& sums, std::uint64_t samples, std::uint32_t block_length);

// Mean over pixels and channels of variance / (mean^2 + 0.01): an estimate of relMSE (docs: interface.md) without a
// reference. Pixels without samples do not count; NaN where no pixel has any.
double error_estimate(const RenderResult& result);

} // namespace selvedge
