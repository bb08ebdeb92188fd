// reference/metrics.hpp: how far one picture is from another. selvedge-compare, the window and tests include it.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include "bake/image.hpp"
#include "flip.hpp"

namespace selvedge
{

struct CompareOptions {
    float exposure = 0.0f; // stops, for FLIP's display transform only
    float pixels_per_degree = flip_pixels_per_degree;
};

inline constexpr double not_available = std::numeric_limits<double>::quiet_NaN();

// Image A against image B, which is taken as the reference. Values are over all pixels and the channels R, G, B; pixels
// with a bad value in either picture (NaN, Inf, negative variance) are left out and counted.
struct Comparison {
    double rmse = 0;
    double relmse = 0;                             // mean of cloth_relmse_term (glsl/color.h)
    double relmse_noise = not_available;           // what the variance layers alone let one expect of relmse
    double relmse_reference_noise = not_available; // the same of B's variance alone: take it off relmse
    double mean_relative_bias = not_available; // (sum A - sum B) / sum B; not available where sum B is 0 and A is not
    std::array<double, 3> mean_relative_bias_of{not_available, not_available, not_available}; // R, G, B
    double mean_relative_bias_sigma = not_available; // one standard deviation of the noise in mean_relative_bias
    double max_abs = 0;
    double flip = 0; // mean of flip_map after cloth_display
    // z = (a - b) / sqrt(variance of both), each pixel and channel by itself: about normal (0, 1) where both have the
    // same expected image and honest variances. z_outliers: share with |z| > 3 (0.0027 of a normal distribution).
    // z_mean and z_std take |z| > 10 as 10, so that one pixel that hid its variance doesn't drown the others.
    double z_outliers = not_available;
    double z_mean = not_available;
    double z_std = not_available;

    std::size_t values = 0;           // pixels * 3 that were compared
    std::size_t z_values = 0;         // of these, values with variance, or different without: z is of these
    std::size_t bad_a = 0, bad_b = 0; // pixels with a bad value
    int worst_x = 0, worst_y = 0;     // where max_abs is
    int first_bad_x = -1, first_bad_y = -1;
    std::vector<float> flip_pixels; // width * height
};

// One row for each metric: thresholds, JSON, table and --help read it.
struct MetricRow {
    const char* name;
    double (*value)(const Comparison&);
    const char* help;
};
const std::vector<MetricRow>& metric_rows();

// Colours are channels R, G, B, or the only channel three times; variances are variance.R, .G, .B (either picture or
// both; where one has none it counts as exact).
//   throws  InputError: no such channels
//   needs   equal sizes
Comparison compare_images(const Image& a, const Image& b, const std::string& name_a, const std::string& name_b,
                          const CompareOptions& options = {});

enum class Heatmap {
    relative,  // root of the pixel's mean relmse term, 0.001 black to 1 white, logarithmic; magma
    flip,      // 0 black to 1 white; magma
    z,         // mean z of the channels, -5 blue (A darker) over white to 5 red (A brighter)
    difference // mean signed relative difference, -0.5 blue to 0.5 red
};

// An 8-bit-ready picture (display values in [0, 1]) of the size of A. Bad pixels are pure green, a colour no ramp has.
Image heatmap(const Image& a, const Image& b, const std::string& name_a, const std::string& name_b,
              const Comparison& comparison, Heatmap kind);

} // namespace selvedge
