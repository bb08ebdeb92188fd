// bake/visibility.cpp: exact periodic horizons, the 8-knot fit, cosine irradiance.
#include "visibility.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <tbb/parallel_for.h>

#include "cloth_bsdf.hpp"
#include "pack.hpp"

namespace selvedge
{

namespace
{

constexpr float pi = 3.14159265358979f;
constexpr int knot_count = 8;
constexpr float far_enough = 16; // height ranges: beyond, a horizon is lower than 3.6 degrees (math.md 8.1: 5)
constexpr int chunk = 64;        // half-resolution texels that march together
constexpr int exit_stride = 4;   // steps between looks at whether a chunk is done

float azimuth_of(int j)
{
    return 2 * pi * (static_cast<float>(j) + 0.5f) / horizon_azimuths;
}

int wrapped(int i, int n)
{
    const int r = i % n;
    return r < 0 ? r + n : r;
}

float sine_of_slope(float rise)
{
    return rise > 0 ? rise / std::sqrt(1 + rise * rise) : 0.0f;
}

// One azimuth as steps over the grid: the larger component moves by one texel, the other by `minor`.
struct March {
    bool along_x;   // the larger component is x
    int way;        // its sign
    float minor;    // texels of the other component for one texel of the larger
    float length_m; // of one step
    int limit;      // steps after which nothing is looked for

    March(const HeightField& field, float range_m, float azimuth)
    {
        const glm::vec2 texel_m = field.tile_m / glm::vec2(field.size);
        const glm::vec2 d = glm::vec2(std::cos(azimuth), std::sin(azimuth)) / texel_m; // texels per metre
        along_x = std::abs(d.x) >= std::abs(d.y);
        const float major = along_x ? d.x : d.y;
        way = major >= 0 ? 1 : -1;
        minor = (along_x ? d.y : d.x) / std::abs(major);
        length_m = 1 / std::abs(major);
        limit =
            static_cast<int>(std::ceil(std::max({field.tile_m.x, field.tile_m.y, far_enough * range_m}) / length_m)) +
            1;
    }
};

// Heights split into even and odd columns, each row twice over: blocks of half-resolution texels read contiguously at
// any offset without wrapping.
struct SplitRows {
    int half = 0;
    std::vector<float> rows[2];

    explicit SplitRows(const HeightField& field) : half(field.size.x / 2)
    {
        for (int parity = 0; parity < 2; ++parity) {
            rows[parity].resize(static_cast<std::size_t>(field.size.y) * static_cast<std::size_t>(half) * 2);
            for (int y = 0; y < field.size.y; ++y)
                for (int i = 0; i < 2 * half; ++i)
                    rows[parity][(static_cast<std::size_t>(y) * 2) * static_cast<std::size_t>(half) +
                                 static_cast<std::size_t>(i)] =
                        (*field.height_m)[static_cast<std::size_t>(y) * static_cast<std::size_t>(field.size.x) +
                                          static_cast<std::size_t>(2 * (i % half) + parity)];
        }
    }
    // Texels 2 X + column for X = first, first + 1, ... in wrapped row y
    const float* at(int y, int column, int first) const
    {
        const int parity = column & 1;
        const int shift = wrapped((column - parity) / 2 + first, half);
        return rows[parity].data() + (static_cast<std::size_t>(y) * 2) * static_cast<std::size_t>(half) +
               static_cast<std::size_t>(shift);
    }
};

// Horizons of one row of blocks: half_w * 32, azimuth fastest.
void march_row(const SplitRows& split, const std::vector<March>& marches, int height_rows, float highest, int Y,
               float* out)
{
    for (int first = 0; first < split.half; first += chunk) {
        const int count = std::min(chunk, split.half - first);
        std::array<float, chunk> from{}, best{};
        for (int i = 0; i < count; ++i)
            from[static_cast<std::size_t>(i)] =
                0.25f * (split.at(2 * Y, 0, first)[i] + split.at(2 * Y, 1, first)[i] +
                         split.at(2 * Y + 1, 0, first)[i] + split.at(2 * Y + 1, 1, first)[i]);
        for (std::size_t j = 0; j < marches.size(); ++j) {
            const March& march = marches[j];
            best.fill(0);
            // The first crossing of a texel line lies half a texel away, inside the block itself: skipped.
            for (int k = 1; k < march.limit; ++k) {
                const float step = static_cast<float>(k) + 0.5f;
                const float distance_m = step * march.length_m, inverse = 1 / distance_m;
                if (k % exit_stride == 0) {
                    float most = -1;
                    for (int i = 0; i < count; ++i)
                        most = std::max(most, highest - from[static_cast<std::size_t>(i)] -
                                                  best[static_cast<std::size_t>(i)] * distance_m);
                    if (most <= 0) break;
                }
                const int major = march.way > 0 ? k + 1 : -k; // from the block's lower texel
                const float other = 0.5f + step * march.minor, floor_of = std::floor(other), f = other - floor_of;
                const int lower = static_cast<int>(floor_of);
                const float* a;
                const float* b;
                if (march.along_x) {
                    a = split.at(wrapped(2 * Y + lower, height_rows), major, first);
                    b = split.at(wrapped(2 * Y + lower + 1, height_rows), major, first);
                } else {
                    const int y = wrapped(2 * Y + major, height_rows);
                    a = split.at(y, lower, first);
                    b = split.at(y, lower + 1, first);
                }
                for (int i = 0; i < count; ++i) {
                    const float rise = (a[i] + f * (b[i] - a[i]) - from[static_cast<std::size_t>(i)]) * inverse;
                    best[static_cast<std::size_t>(i)] = std::max(best[static_cast<std::size_t>(i)], rise);
                }
            }
            for (int i = 0; i < count; ++i)
                out[static_cast<std::size_t>(first + i) * horizon_azimuths + j] =
                    sine_of_slope(best[static_cast<std::size_t>(i)]);
        }
    }
}

// knots = fit * horizons: (B^T B)^-1 B^T with the rows of the spline's basis at the marched azimuths, the same for
// every block.
using KnotFit = std::array<std::array<float, horizon_azimuths>, knot_count>;
KnotFit knot_fit()
{
    using Row = std::array<double, knot_count>;
    std::array<Row, horizon_azimuths> basis{};
    for (int j = 0; j < horizon_azimuths; ++j) {
        const float g = cloth::f32::cloth_horizon_azimuth({std::cos(azimuth_of(j)), std::sin(azimuth_of(j))});
        const int k = static_cast<int>(g) % knot_count;
        const double f = static_cast<double>(g) - std::floor(static_cast<double>(g));
        basis[static_cast<std::size_t>(j)][static_cast<std::size_t>(k)] += 1 - f;
        basis[static_cast<std::size_t>(j)][static_cast<std::size_t>((k + 1) % knot_count)] += f;
    }
    std::array<std::array<double, knot_count + horizon_azimuths>, knot_count> system{}; // [B^T B | B^T]
    for (std::size_t r = 0; r < knot_count; ++r)
        for (std::size_t j = 0; j < horizon_azimuths; ++j) {
            for (std::size_t c = 0; c < knot_count; ++c) system[r][c] += basis[j][r] * basis[j][c];
            system[r][knot_count + j] = basis[j][r];
        }
    for (std::size_t pivot = 0; pivot < knot_count; ++pivot) { // Gauss-Jordan; B^T B is diagonally dominant
        const double scale = 1 / system[pivot][pivot];
        for (double& value : system[pivot]) value *= scale;
        for (std::size_t r = 0; r < knot_count; ++r) {
            if (r == pivot) continue;
            const double factor = system[r][pivot];
            for (std::size_t c = 0; c < system[r].size(); ++c) system[r][c] -= factor * system[pivot][c];
        }
    }
    KnotFit fit{};
    for (std::size_t k = 0; k < knot_count; ++k)
        for (std::size_t j = 0; j < horizon_azimuths; ++j) fit[k][j] = static_cast<float>(system[k][knot_count + j]);

    return fit;
}

glm::uvec2 fit_knots(const KnotFit& fit, const float* horizons)
{
    float knots[knot_count];
    for (std::size_t k = 0; k < knot_count; ++k) {
        float sum = 0;
        for (std::size_t j = 0; j < horizon_azimuths; ++j) sum += fit[k][j] * horizons[j];
        knots[k] = sum;
    }
    return pack_knots(knots); // clamps
}

} // namespace

glm::vec2 height_range(const HeightField& field)
{
    const auto [low, high] = std::minmax_element(field.height_m->begin(), field.height_m->end());
    return {*low, *high};
}

std::vector<glm::uvec2> horizon_knots(const HeightField& field)
{
    const int half_w = field.size.x / 2, half_h = field.size.y / 2;
    const float lowest = height_range(field).x, highest = height_range(field).y;
    const SplitRows split(field);
    const KnotFit fit = knot_fit();
    std::vector<March> marches;
    for (int j = 0; j < horizon_azimuths; ++j) marches.emplace_back(field, highest - lowest, azimuth_of(j));

    std::vector<glm::uvec2> out(static_cast<std::size_t>(half_w) * static_cast<std::size_t>(half_h));
    tbb::parallel_for(0, half_h, [&](int Y) {
        std::vector<float> row(static_cast<std::size_t>(half_w) * horizon_azimuths);
        march_row(split, marches, field.size.y, highest, Y, row.data());
        for (int X = 0; X < half_w; ++X)
            out[static_cast<std::size_t>(Y) * static_cast<std::size_t>(half_w) + static_cast<std::size_t>(X)] =
                fit_knots(fit, row.data() + static_cast<std::size_t>(X) * horizon_azimuths);
    });
    return out;
}

float march_horizon(const HeightField& field, glm::vec2 range_m, glm::vec2 at, float azimuth)
{
    const int w = field.size.x, h = field.size.y;
    const std::vector<float>& height = *field.height_m;
    const auto texel = [&](int x, int y) {
        return height[static_cast<std::size_t>(wrapped(y, h)) * static_cast<std::size_t>(w) +
                      static_cast<std::size_t>(wrapped(x, w))];
    };
    const auto sample = [&](glm::vec2 p) { // bilinear
        const glm::vec2 q = p - 0.5f, base = glm::floor(q), f = q - base;
        const int x = static_cast<int>(base.x), y = static_cast<int>(base.y);
        return glm::mix(glm::mix(texel(x, y), texel(x + 1, y), f.x),
                        glm::mix(texel(x, y + 1), texel(x + 1, y + 1), f.x), f.y);
    };
    const float highest_m = range_m.y;
    const March march(field, range_m.y - range_m.x, azimuth);
    const float from = sample(at);
    const glm::vec2 step = march.along_x ? glm::vec2(march.way, march.minor) : glm::vec2(march.minor, march.way);
    // To the next line of texel centres that is at least one texel away.
    const float major = march.along_x ? at.x : at.y;
    const float to_line =
        march.way > 0 ? std::ceil(major + 0.5f) - 0.5f - major : major - (std::floor(major - 0.5f) + 0.5f);
    float best = 0, k = to_line < 1 ? to_line + 1 : to_line;
    for (; k < static_cast<float>(march.limit); k += 1) {
        const float distance_m = k * march.length_m;
        if (highest_m - from <= best * distance_m) break;
        best = std::max(best, (sample(at + k * step) - from) / distance_m);
    }
    return sine_of_slope(best);
}

std::vector<float> cosine_irradiance(const std::vector<glm::uvec2>& knots, const std::vector<glm::vec2>& slopes,
                                     glm::ivec2 size)
{
    const int half_w = size.x / 2, half_h = size.y / 2;
    std::array<glm::vec2, knot_count> way;
    for (int k = 0; k < knot_count; ++k)
        way[static_cast<std::size_t>(k)] = {std::cos(pi * static_cast<float>(k) / 4),
                                            std::sin(pi * static_cast<float>(k) / 4)};

    std::vector<float> out(slopes.size());
    tbb::parallel_for(0, size.y, [&](int y) {
        const int Y = y / 2, Y1 = wrapped(y % 2 ? Y + 1 : Y - 1, half_h); // 3/4 the own block, 1/4 the neighbour
        for (int x = 0; x < size.x; ++x) {
            const int X = x / 2, X1 = wrapped(x % 2 ? X + 1 : X - 1, half_w);
            float s[knot_count] = {}, corner[knot_count];
            const auto add = [&](int cx, int cy, float weight) {
                unpack_knots(knots[static_cast<std::size_t>(cy) * static_cast<std::size_t>(half_w) +
                                   static_cast<std::size_t>(cx)],
                             corner);
                for (int k = 0; k < knot_count; ++k) s[k] += weight * corner[k];
            };
            add(X, Y, 0.5625f), add(X1, Y, 0.1875f), add(X, Y1, 0.1875f), add(X1, Y1, 0.0625f);

            const std::size_t texel =
                static_cast<std::size_t>(y) * static_cast<std::size_t>(size.x) + static_cast<std::size_t>(x);
            const glm::vec2 slope = glm::clamp(slopes[texel], -slope_limit, slope_limit);
            const float nz = 1 / std::sqrt(1 + glm::dot(slope, slope));
            float sum = 0;
            for (int k = 0; k < knot_count; ++k) {
                const float nf = -nz * glm::dot(slope, way[static_cast<std::size_t>(k)]);
                const float length = std::sqrt(nz * nz + nf * nf);
                const float low = std::clamp(std::max(s[k], -nf / length), 0.0f, 1.0f);
                const float r = std::sqrt(std::max(0.0f, 1 - low * low));
                sum += nz * (1 - low * low) / 2 + nf * (std::acos(low) - low * r) / 2;
            }
            out[texel] = std::clamp(sum * (2 * pi / knot_count) / pi, 0.0f, 1.0f);
        }
    });
    return out;
}

} // namespace selvedge

namespace selvedge
{

std::vector<glm::vec4> fit_asg(const HeightField& field, bool least_squares)
{
    namespace f64 = cloth::f64;
    constexpr double pi_d = 3.14159265358979323846, dphi = 2 * pi_d / horizon_azimuths;
    const glm::vec2 range_m = height_range(field);
    std::vector<glm::vec4> records(2 * field.height_m->size());
    tbb::parallel_for(0, field.size.y, [&](int y) {
        for (int x = 0; x < field.size.x; ++x) {
            double s[horizon_azimuths];
            glm::dvec3 sum(0);
            double omega = 0;
            glm::dmat3 second(0);
            for (int k = 0; k < horizon_azimuths; ++k) {
                const double phi = dphi * (k + 0.5), c = std::cos(phi), n = std::sin(phi);
                s[k] = double(march_horizon(field, range_m, {float(x) + 0.5f, float(y) + 0.5f}, float(phi)));
                const double r = std::sqrt(std::max(1 - s[k] * s[k], 0.0)), s3 = s[k] * s[k] * s[k];
                omega += dphi * (1 - s[k]);
                const double across = dphi * (std::acos(std::clamp(s[k], 0.0, 1.0)) - s[k] * r) / 2;
                sum += glm::dvec3(across * c, across * n, dphi * (1 - s[k] * s[k]) / 2);
                const double h = dphi * (2.0 / 3.0 - s[k] + s3 / 3), v = dphi * r * r * r / 3;
                second += glm::dmat3(h * c * c, h * c * n, v * c, h * c * n, h * n * n, v * n, v * c, v * n,
                                     dphi * (1 - s3) / 3);
            }
            const glm::dvec3 mu = f64::cloth_unit_vector(sum, {0, 0, 1});
            const f64::ClothFrame frame = f64::cloth_frame(mu);
            const double over = 1 / std::max(omega, 1e-6);
            const double xx = glm::dot(frame.x, second * frame.x) * over,
                         xy = glm::dot(frame.x, second * frame.y) * over,
                         yy = glm::dot(frame.y, second * frame.y) * over;
            const double middle = (xx + yy) / 2, spread = std::hypot((xx - yy) / 2, xy);
            const double gamma = std::atan2(2 * xy, xx - yy) / 2;
            const double sigma_x = 1 / (2 * std::max(middle + spread, 1e-4)),
                         sigma_y = 1 / (2 * std::max(middle - spread, 1e-4));
            double amplitude = omega > 1e-6 ? 1 : 0;
            if (least_squares && amplitude > 0) {
                const f64::real4 axis(mu, gamma), shape(sigma_x, sigma_y, 1, 0);
                double va = 0, aa = 0;
                constexpr int rings = 16;
                for (int k = 0; k < horizon_azimuths; ++k)
                    for (int j = 0; j < rings; ++j) {
                        const double z = (j + 0.5) / rings, r = std::sqrt(1 - z * z), phi = dphi * (k + 0.5);
                        const double a =
                            f64::cloth_asg_visibility(axis, shape, {r * std::cos(phi), r * std::sin(phi), z});
                        va += z > s[k] ? a : 0;
                        aa += a * a;
                    }
                amplitude = va / std::max(aa, 1e-9);
            }
            const std::size_t at = 2 * (std::size_t(y) * std::size_t(field.size.x) + std::size_t(x));
            records[at] = glm::vec4(glm::dvec4(mu, gamma));
            records[at + 1] = glm::vec4(glm::dvec4(sigma_x, sigma_y, amplitude, 0));
        }
    });
    return records;
}

} // namespace selvedge
