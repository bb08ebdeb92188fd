// reference/metrics.cpp: metrics of two pictures, in rows so that the sums don't depend on the number of threads.
#include "metrics.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <numeric>

#include <glm/glm.hpp>
#include <tbb/parallel_for.h>

#include "bake/error.hpp"
#include "glsl/cloth_bsdf.hpp"

namespace selvedge
{

namespace
{

// Two devices' float32 arithmetic may differ by this much of a value that has no noise at all (a constant sky).
constexpr double rounding = 1e-5;
constexpr double z_limit = 3.0, z_clamp = 10.0;

// One picture's channels by meaning.
struct Channels {
    const Image& image;
    std::array<int, 3> colour{-1, -1, -1}, variance{-1, -1, -1};

    Channels(const Image& picture, const std::string& name) : image(picture)
    {
        constexpr const char* letters[] = {"R", "G", "B"};
        for (std::size_t c = 0; c < 3; ++c) {
            colour[c] = image.channel_count() == 1 ? 0 : image.channel(letters[c]);
            variance[c] = image.channel(std::string("variance.") + letters[c]);
            if (colour[c] < 0)
                throw InputError(name, 0, "no channel %s, expected R, G, B or one channel alone", letters[c]);
        }
        const auto missing = std::count(variance.begin(), variance.end(), -1);
        if (missing == 1 || missing == 2)
            throw InputError(name, 0, "variance of some channels only, expected variance.R, variance.G, variance.B");
    }

    bool has_variance() const { return variance[0] >= 0; }

    double value(int x, int y, std::size_t c) const { return static_cast<double>(image.at(x, y)[colour[c]]); }

    double variance_of(int x, int y, std::size_t c) const
    {
        return has_variance() ? static_cast<double>(image.at(x, y)[variance[c]]) : 0.0;
    }

    bool is_bad(int x, int y) const
    {
        for (std::size_t c = 0; c < 3; ++c)
            if (!std::isfinite(value(x, y, c)) || !(variance_of(x, y, c) >= 0.0) || std::isinf(variance_of(x, y, c)))
                return true;
        return false;
    }
};

// z of one channel; NaN where neither picture has noise there and both agree: such a value tells nothing about noise.
double z_score(double a, double b, double variance)
{
    const double floor = rounding * std::max(std::abs(a), std::abs(b));
    const double difference = a - b;
    if (variance <= 0.0 && std::abs(difference) <= z_limit * floor) return not_available;
    const double sigma = std::sqrt(variance + floor * floor);
    return difference / std::max(sigma, std::numeric_limits<double>::min());
}

// What one row adds.
struct Sums {
    std::array<double, 3> a{}, b{}, variance{}, variance_b{};
    double squared = 0, relative = 0, relative_noise = 0, relative_noise_b = 0;
    double z = 0, z_squared = 0;
    std::size_t values = 0, z_values = 0, z_outliers = 0, bad_a = 0, bad_b = 0;
    double worst = -1;
    int worst_x = 0, worst_y = 0, bad_x = -1, bad_y = -1;

    void add(const Sums& row)
    {
        for (std::size_t c = 0; c < 3; ++c) {
            a[c] += row.a[c];
            b[c] += row.b[c];
            variance[c] += row.variance[c];
            variance_b[c] += row.variance_b[c];
        }
        squared += row.squared;
        relative += row.relative;
        relative_noise += row.relative_noise;
        relative_noise_b += row.relative_noise_b;
        z += row.z;
        z_squared += row.z_squared;
        values += row.values;
        z_values += row.z_values;
        z_outliers += row.z_outliers;
        bad_a += row.bad_a;
        bad_b += row.bad_b;
        if (row.worst > worst) {
            worst = row.worst;
            worst_x = row.worst_x;
            worst_y = row.worst_y;
        }
        if (bad_x < 0) {
            bad_x = row.bad_x;
            bad_y = row.bad_y;
        }
    }
};

Sums sum_row(const Channels& a, const Channels& b, int y)
{
    Sums sums;
    for (int x = 0; x < a.image.width; ++x) {
        const bool bad_a = a.is_bad(x, y), bad_b = b.is_bad(x, y);
        if (bad_a || bad_b) {
            sums.bad_a += bad_a;
            sums.bad_b += bad_b;
            if (sums.bad_x < 0) {
                sums.bad_x = x;
                sums.bad_y = y;
            }
            continue;
        }
        for (std::size_t c = 0; c < 3; ++c) {
            const double va = a.value(x, y, c), vb = b.value(x, y, c), difference = va - vb;
            const double noise_b = b.variance_of(x, y, c), noise = a.variance_of(x, y, c) + noise_b;
            // cloth_relmse_term(v, r) is d^2 over a weight of r, so noise is the same term with d^2 replaced by a
            // variance.
            const double weight = cloth::f64::cloth_relmse_term(vb + 1.0, vb);
            sums.a[c] += va;
            sums.b[c] += vb;
            sums.variance[c] += noise;
            sums.squared += difference * difference;
            sums.relative += cloth::f64::cloth_relmse_term(va, vb);
            sums.relative_noise += noise * weight;
            sums.relative_noise_b += noise_b * weight;
            ++sums.values;
            if (std::abs(difference) > sums.worst) {
                sums.worst = std::abs(difference);
                sums.worst_x = x;
                sums.worst_y = y;
            }
            const double z = z_score(va, vb, noise);
            if (std::isnan(z)) continue;
            const double bounded = std::clamp(z, -z_clamp, z_clamp);
            ++sums.z_values;
            sums.z += bounded;
            sums.z_squared += bounded * bounded;
            sums.z_outliers += std::abs(z) > z_limit;
        }
    }
    return sums;
}

double relative_bias(double a, double b)
{
    if (a == b) return 0.0;
    return b == 0.0 ? not_available : (a - b) / b;
}

double total(const std::array<double, 3>& values)
{
    return std::accumulate(values.begin(), values.end(), 0.0);
}

std::vector<float> displayed(const Channels& channels, float exposure)
{
    const Image& image = channels.image;
    const auto stride = 3 * static_cast<std::size_t>(image.width);
    std::vector<float> codes(stride * static_cast<std::size_t>(image.height));
    tbb::parallel_for(0, image.height, [&](int y) {
        float* out = codes.data() + stride * static_cast<std::size_t>(y);
        for (int x = 0; x < image.width; ++x) {
            glm::vec3 radiance;
            for (int c = 0; c < 3; ++c) radiance[c] = image.at(x, y)[channels.colour[static_cast<std::size_t>(c)]];
            // The transform knows NaN (magenta) but not infinity.
            if (!glm::all(glm::lessThan(glm::abs(radiance), glm::vec3(std::numeric_limits<float>::infinity()))))
                radiance = glm::vec3(std::numeric_limits<float>::quiet_NaN());
            const glm::vec3 code = cloth::f32::cloth_display(radiance, exposure);
            for (int c = 0; c < 3; ++c) *out++ = code[c];
        }
    });
    return codes;
}

// matplotlib's magma (CC0) at 17 equal steps, linear in between: at most 3 of 255 off.
glm::vec3 magma(double t)
{
    static constexpr std::uint32_t knots[] = {0x000004, 0x0a0822, 0x1d1147, 0x36106b, 0x51127c, 0x6a1c81,
                                              0x832681, 0x9c2e7f, 0xb73779, 0xd0416f, 0xe75263, 0xf56b5c,
                                              0xfc8961, 0xfea772, 0xfec488, 0xfde2a3, 0xfcfdbf};
    constexpr auto last = static_cast<double>(std::size(knots) - 1);
    const double place = std::clamp(t, 0.0, 1.0) * last;
    const double low = std::min(std::floor(place), last - 1.0);
    const auto colour = [](std::uint32_t k) { return glm::vec3(k >> 16, (k >> 8) & 255u, k & 255u) / 255.0f; };
    const auto index = static_cast<std::size_t>(low);
    return glm::mix(colour(knots[index]), colour(knots[index + 1]), static_cast<float>(place - low));
}

// -1 blue, 0 white, 1 red.
glm::vec3 diverging(double t)
{
    const auto amount = static_cast<float>(std::min(std::abs(t), 1.0));
    return glm::mix(glm::vec3(1.0f), t < 0.0 ? glm::vec3(0.02f, 0.25f, 0.65f) : glm::vec3(0.70f, 0.05f, 0.09f), amount);
}

} // namespace

const std::vector<MetricRow>& metric_rows()
{
    using C = const Comparison&;
    static const std::vector<MetricRow> rows{
        {"rmse", [](C c) { return c.rmse; }, "root of the mean squared difference"},
        {"relmse", [](C c) { return c.relmse; }, "mean of (a-b)^2 / (b^2 + 0.01)"},
        {"relmse_noise", [](C c) { return c.relmse_noise; }, "relmse to expect of the variance layers alone"},
        {"relmse_reference_noise", [](C c) { return c.relmse_reference_noise; }, "the part of it that is B's noise"},
        {"mean_relative_bias", [](C c) { return c.mean_relative_bias; }, "(sum A - sum B) / sum B"},
        {"mean_relative_bias.R", [](C c) { return c.mean_relative_bias_of[0]; }, "the same of the red channel"},
        {"mean_relative_bias.G", [](C c) { return c.mean_relative_bias_of[1]; }, "of the green channel"},
        {"mean_relative_bias.B", [](C c) { return c.mean_relative_bias_of[2]; }, "of the blue channel"},
        {"mean_relative_bias_sigma", [](C c) { return c.mean_relative_bias_sigma; },
         "its noise, one standard deviation"},
        {"max_abs", [](C c) { return c.max_abs; }, "largest difference of one channel"},
        {"flip", [](C c) { return c.flip; }, "mean LDR-FLIP after the display transform, 0 to 1"},
        {"z_outliers", [](C c) { return c.z_outliers; }, "share of values with |z| > 3; noise alone gives 0.0027"},
        {"z_mean", [](C c) { return c.z_mean; }, "mean of z; noise alone gives 0"},
        {"z_std", [](C c) { return c.z_std; }, "standard deviation of z; honest variance gives 1"}};
    return rows;
}

Comparison compare_images(const Image& image_a, const Image& image_b, const std::string& name_a,
                          const std::string& name_b, const CompareOptions& options)
{
    assert(image_a.width == image_b.width && image_a.height == image_b.height);
    const Channels a(image_a, name_a), b(image_b, name_b);

    std::vector<Sums> rows(static_cast<std::size_t>(image_a.height));
    tbb::parallel_for(0, image_a.height, [&](int y) { rows[static_cast<std::size_t>(y)] = sum_row(a, b, y); });
    Sums sums;
    for (const Sums& row : rows) sums.add(row);

    Comparison result;
    result.values = sums.values;
    result.bad_a = sums.bad_a;
    result.bad_b = sums.bad_b;
    result.first_bad_x = sums.bad_x;
    result.first_bad_y = sums.bad_y;
    if (sums.values == 0) {
        result.rmse = result.relmse = result.max_abs = not_available;
    } else {
        const auto values = static_cast<double>(sums.values);
        result.rmse = std::sqrt(sums.squared / values);
        result.relmse = sums.relative / values;
        result.max_abs = sums.worst;
        result.worst_x = sums.worst_x;
        result.worst_y = sums.worst_y;
        result.mean_relative_bias = relative_bias(total(sums.a), total(sums.b));
        for (std::size_t c = 0; c < 3; ++c) result.mean_relative_bias_of[c] = relative_bias(sums.a[c], sums.b[c]);
        if (a.has_variance() || b.has_variance()) {
            result.relmse_noise = sums.relative_noise / values;
            if (total(sums.b) != 0.0)
                result.mean_relative_bias_sigma = std::sqrt(total(sums.variance)) / std::abs(total(sums.b));
        }
        if (b.has_variance()) result.relmse_reference_noise = sums.relative_noise_b / values;
    }
    if ((a.has_variance() || b.has_variance()) && sums.values > 0) {
        const auto values = static_cast<double>(std::max<std::size_t>(sums.z_values, 1));
        result.z_values = sums.z_values;
        result.z_outliers = static_cast<double>(sums.z_outliers) / values;
        result.z_mean = sums.z / values;
        result.z_std = std::sqrt(std::max(sums.z_squared / values - result.z_mean * result.z_mean, 0.0));
    }

    result.flip_pixels = flip_map(displayed(b, options.exposure), displayed(a, options.exposure), image_a.width,
                                  image_a.height, options.pixels_per_degree);
    const double flip_sum = std::accumulate(result.flip_pixels.begin(), result.flip_pixels.end(), 0.0);
    result.flip = flip_sum / static_cast<double>(result.flip_pixels.size());
    return result;
}

Image heatmap(const Image& image_a, const Image& image_b, const std::string& name_a, const std::string& name_b,
              const Comparison& comparison, Heatmap kind)
{
    const Channels a(image_a, name_a), b(image_b, name_b);
    Image picture(image_a.width, image_a.height, {"R", "G", "B"});
    tbb::parallel_for(0, picture.height, [&](int y) {
        for (int x = 0; x < picture.width; ++x) {
            double relative = 0, difference = 0, z = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                const double va = a.value(x, y, c), vb = b.value(x, y, c);
                const double term = cloth::f64::cloth_relmse_term(va, vb);
                relative += term / 3.0;
                difference += std::copysign(std::sqrt(term), va - vb) / 3.0;
                const double score = z_score(va, vb, a.variance_of(x, y, c) + b.variance_of(x, y, c));
                z += (std::isnan(score) ? 0.0 : score) / 3.0;
            }
            const auto pixel =
                static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width) + static_cast<std::size_t>(x);
            glm::vec3 colour(0.0f, 1.0f, 0.0f);
            if (a.is_bad(x, y) || b.is_bad(x, y)) {
                // stays green
            } else if (kind == Heatmap::relative) {
                colour = magma(1.0 + std::log10(std::max(std::sqrt(relative), 1e-9)) / 3.0);
            } else if (kind == Heatmap::flip) {
                colour = magma(static_cast<double>(comparison.flip_pixels[pixel]));
            } else {
                colour = diverging(kind == Heatmap::z ? z / 5.0 : difference / 0.5);
            }
            for (int c = 0; c < 3; ++c) picture.at(x, y)[c] = colour[c];
        }
    });
    return picture;
}

} // namespace selvedge
