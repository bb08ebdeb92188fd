// reference/flip.cpp: LDR-FLIP. All filters are separable; each pass runs over rows in parallel.
#include "flip.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>

#include <glm/glm.hpp>
#include <tbb/parallel_for.h>

namespace selvedge
{

namespace
{

using Plane = std::vector<float>;   // width * height
using Kernel = std::vector<double>; // 2 * radius + 1 weights

constexpr double pi = 3.14159265358979323846;

// Section 3 of the paper: exponents of the colour and feature differences, and the range of the colour difference.
constexpr float q_colour = 0.7f, q_feature = 0.5f;
constexpr float p_break = 0.4f, p_share = 0.95f;
constexpr double feature_width_deg = 0.082; // of the narrowest feature that the detectors answer to

// Linear Rec.709 to CIE XYZ, from the primaries and the D65 white (0.3127, 0.3290); columns.
const glm::mat3 xyz_from_rgb(0.41238656f, 0.21263682f, 0.01933062f,  // R
                             0.35759149f, 0.71518298f, 0.11919716f,  // G
                             0.18045049f, 0.07218020f, 0.95037259f); // B
const glm::mat3 rgb_from_xyz = glm::inverse(xyz_from_rgb);
const glm::vec3 white_xyz = xyz_from_rgb * glm::vec3(1.0f);

float linear_from_srgb(float v)
{
    v = v > 0.0f ? std::min(v, 1.0f) : 0.0f; // NaN fails the comparison
    return v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f);
}

// The linearised opponent space in which the contrast sensitivity functions are stated.
glm::vec3 ycxcz_from_rgb(glm::vec3 rgb)
{
    const glm::vec3 t = xyz_from_rgb * rgb / white_xyz;
    return {116.0f * t.y - 16.0f, 500.0f * (t.x - t.y), 200.0f * (t.y - t.z)};
}

glm::vec3 rgb_from_ycxcz(glm::vec3 c)
{
    const float y = (c.x + 16.0f) / 116.0f;
    return rgb_from_xyz * (glm::vec3(y + c.y / 500.0f, y, y - c.z / 200.0f) * white_xyz);
}

// L*a*b* with the Hunt effect: chroma is seen less the darker it is.
glm::vec3 hunt_lab_from_rgb(glm::vec3 rgb)
{
    const auto curve = [](float t) {
        constexpr float d = 6.0f / 29.0f;
        return t > d * d * d ? std::cbrt(t) : t / (3.0f * d * d) + 4.0f / 29.0f;
    };
    const glm::vec3 t = xyz_from_rgb * rgb / white_xyz;
    const float y = curve(t.y), lightness = 116.0f * y - 16.0f, hunt = 0.01f * lightness;
    return {lightness, 500.0f * (curve(t.x) - y) * hunt, 200.0f * (y - curve(t.z)) * hunt};
}

// City-block in lightness plus Euclid in chroma, for differences too large for CIE76.
float hyab(glm::vec3 p, glm::vec3 q)
{
    return std::abs(p.x - q.x) + std::hypot(p.y - q.y, p.z - q.z);
}

// Size and number type of one picture's passes.
struct Filter {
    int width, height;

    template <class Body> void each_row(Body&& body) const
    {
        tbb::parallel_for(0, height, [&](int y) { body(y); });
    }

    std::size_t row(int y) const { return static_cast<std::size_t>(y) * static_cast<std::size_t>(width); }

    // source filtered along x, then along y; edge pixels are repeated outward. Weights are taken as they are.
    Plane apply(const Plane& source, const Kernel& along_x, const Kernel& along_y) const
    {
        const auto columns = static_cast<std::size_t>(width);
        Plane middle(source.size()), result(source.size());
        each_row([&](int y) {
            const int radius = static_cast<int>(along_x.size() / 2);
            std::vector<float> padded(columns + 2 * static_cast<std::size_t>(radius));
            for (std::size_t i = 0; i < padded.size(); ++i)
                padded[i] =
                    source[row(y) + static_cast<std::size_t>(std::clamp(static_cast<int>(i) - radius, 0, width - 1))];
            float* out = middle.data() + row(y);
            for (std::size_t k = 0; k < along_x.size(); ++k) {
                const auto weight = static_cast<float>(along_x[k]);
                for (std::size_t x = 0; x < columns; ++x) out[x] += weight * padded[x + k];
            }
        });
        each_row([&](int y) {
            const int radius = static_cast<int>(along_y.size() / 2);
            float* out = result.data() + row(y);
            for (int k = -radius; k <= radius; ++k) {
                const auto weight = static_cast<float>(along_y[static_cast<std::size_t>(k + radius)]);
                const float* in = middle.data() + row(std::clamp(y + k, 0, height - 1));
                for (std::size_t x = 0; x < columns; ++x) out[x] += weight * in[x];
            }
        });
        return result;
    }
};

// Kernels of one channel's contrast sensitivity: sum over terms of share * g(x) g(y).
struct Sensitivity {
    struct Term {
        double share;
        Kernel kernel; // sums to 1
    };
    std::vector<Term> terms;
};

// Gaussians a sqrt(pi / b) exp(-pi^2 d^2 / b) over distance d in degrees (table 1 of the paper), cut off at a radius
// that all channels share and normalised to sum 1 over the pixels of the square.
Sensitivity sensitivity(std::initializer_list<std::array<double, 2>> gaussians, double pixels_per_degree)
{
    constexpr double widest_b = 0.04;
    const int radius = static_cast<int>(std::ceil(3.0 * std::sqrt(widest_b / (2.0 * pi * pi)) * pixels_per_degree));
    Sensitivity result;
    double total = 0.0;
    for (const auto& [a, b] : gaussians) {
        Sensitivity::Term term{0.0, {}};
        double sum = 0.0;
        for (int i = -radius; i <= radius; ++i) {
            const double d = i / pixels_per_degree;
            term.kernel.push_back(std::exp(-pi * pi * d * d / b));
            sum += term.kernel.back();
        }
        for (double& weight : term.kernel) weight /= sum;
        term.share = a * std::sqrt(pi / b) * sum * sum;
        total += term.share;
        result.terms.push_back(std::move(term));
    }
    for (auto& term : result.terms) term.share /= total;
    return result;
}

Plane filtered(const Filter& filter, const Plane& plane, const Sensitivity& sensitivity)
{
    Plane sum;
    for (const auto& [share, kernel] : sensitivity.terms) {
        Kernel scaled = kernel;
        for (double& weight : scaled) weight *= share;
        Plane part = filter.apply(plane, scaled, kernel);
        if (sum.empty())
            sum = std::move(part);
        else
            std::transform(sum.begin(), sum.end(), part.begin(), sum.begin(), std::plus<>());
    }
    return sum;
}

// Gaussian and its first and second derivative; the derivatives' positive weights sum to 1, their negative ones to -1.
struct Detectors {
    Kernel blur, edge, point;
};

Detectors detectors(double pixels_per_degree)
{
    const double deviation = 0.5 * feature_width_deg * pixels_per_degree;
    const int radius = static_cast<int>(std::ceil(3.0 * deviation));
    Detectors result;
    for (int i = -radius; i <= radius; ++i) {
        const double g = std::exp(-0.5 * i * i / (deviation * deviation));
        result.blur.push_back(g);
        result.edge.push_back(-i * g);
        result.point.push_back((i * i / (deviation * deviation) - 1.0) * g);
    }
    for (Kernel* kernel : {&result.blur, &result.edge, &result.point}) {
        double positive = 0.0, negative = 0.0;
        for (const double weight : *kernel) (weight > 0.0 ? positive : negative) += std::abs(weight);
        for (double& weight : *kernel) weight /= weight > 0.0 ? positive : negative > 0.0 ? negative : 1.0;
    }
    return result;
}

// What the eye makes of one picture: colours after the contrast sensitivity, strength of edges and points.
struct Seen {
    std::vector<glm::vec3> colour; // Hunt-adjusted L*a*b*
    Plane edge, point;
};

Seen see(const Filter& filter, const std::vector<float>& picture, double pixels_per_degree)
{
    const std::size_t count = filter.row(filter.height);
    std::array<Plane, 3> opponent{Plane(count), Plane(count), Plane(count)};
    Plane lightness(count);
    filter.each_row([&](int y) {
        for (std::size_t i = filter.row(y); i < filter.row(y + 1); ++i) {
            const glm::vec3 c = ycxcz_from_rgb({linear_from_srgb(picture[3 * i]), linear_from_srgb(picture[3 * i + 1]),
                                                linear_from_srgb(picture[3 * i + 2])});
            for (int k = 0; k < 3; ++k) opponent[static_cast<std::size_t>(k)][i] = c[k];
            lightness[i] = (c.x + 16.0f) / 116.0f;
        }
    });

    Seen seen;
    const Detectors kernels = detectors(pixels_per_degree);
    const auto strength = [&](const Kernel& kernel) {
        Plane x = filter.apply(lightness, kernel, kernels.blur);
        const Plane y = filter.apply(lightness, kernels.blur, kernel);
        for (std::size_t i = 0; i < count; ++i) x[i] = std::hypot(x[i], y[i]);
        return x;
    };
    seen.edge = strength(kernels.edge);
    seen.point = strength(kernels.point);

    const std::array<Sensitivity, 3> channels{
        sensitivity({{1.0, 0.0047}}, pixels_per_degree),                // achromatic
        sensitivity({{1.0, 0.0053}}, pixels_per_degree),                // red-green
        sensitivity({{34.1, 0.04}, {13.5, 0.025}}, pixels_per_degree)}; // blue-yellow
    for (std::size_t k = 0; k < 3; ++k) opponent[k] = filtered(filter, opponent[k], channels[k]);
    seen.colour.resize(count);
    filter.each_row([&](int y) {
        for (std::size_t i = filter.row(y); i < filter.row(y + 1); ++i)
            seen.colour[i] = hunt_lab_from_rgb(
                glm::clamp(rgb_from_ycxcz({opponent[0][i], opponent[1][i], opponent[2][i]}), 0.0f, 1.0f));
    });
    return seen;
}

} // namespace

std::vector<float> flip_map(const std::vector<float>& reference, const std::vector<float>& test, int width, int height,
                            float pixels_per_degree)
{
    const Filter filter{width, height};
    assert(reference.size() == 3 * filter.row(height) && test.size() == reference.size());
    const Seen a = see(filter, reference, static_cast<double>(pixels_per_degree));
    const Seen b = see(filter, test, static_cast<double>(pixels_per_degree));

    // The largest difference in gamut is that of pure green and pure blue.
    const float largest =
        std::pow(hyab(hunt_lab_from_rgb({0.0f, 1.0f, 0.0f}), hunt_lab_from_rgb({0.0f, 0.0f, 1.0f})), q_colour);
    Plane result(filter.row(height));
    filter.each_row([&](int y) {
        for (std::size_t i = filter.row(y); i < filter.row(y + 1); ++i) {
            const float difference = std::pow(hyab(a.colour[i], b.colour[i]), q_colour);
            const float knee = p_break * largest;
            const float colour = difference < knee
                                     ? p_share / knee * difference
                                     : p_share + (difference - knee) / (largest - knee) * (1.0f - p_share);
            const float feature =
                std::pow(std::max(std::abs(a.edge[i] - b.edge[i]), std::abs(a.point[i] - b.point[i])) / std::sqrt(2.0f),
                         q_feature);
            result[i] = std::pow(std::clamp(colour, 0.0f, 1.0f), 1.0f - std::min(feature, 1.0f));
        }
    });
    return result;
}

} // namespace selvedge
