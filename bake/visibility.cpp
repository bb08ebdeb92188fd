// bake/visibility.cpp: the sweep for exact periodic horizons, the fits to them, cosine irradiance, the march as oracle.
#include "visibility.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <tbb/parallel_for.h>

#include "cloth_bsdf.hpp"
#include "pack.hpp"

namespace selvedge
{

namespace
{

namespace f64 = cloth::f64;

constexpr double pi_d = 3.14159265358979323846;
constexpr float pi = 3.14159265358979f;
constexpr int knot_count = 8;
constexpr float far_enough = cloth::f32::cloth_exact_reach; // height ranges

int wrapped(int i, int n)
{
    const int r = i % n;
    return r < 0 ? r + n : r;
}

float sine_of_slope(float rise)
{
    return std::max(rise, 0.0f) / std::sqrt(1 + rise * rise);
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

// ---- the sweep

// Heights with the axis that the lines run along contiguous.
struct SweepField {
    int along = 0, across = 0; // texels
    std::vector<float> height; // across rows of `along` values

    SweepField(const HeightField& field, bool along_x)
        : along(along_x ? field.size.x : field.size.y), across(along_x ? field.size.y : field.size.x)
    {
        if (along_x) {
            height = *field.height_m;
            return;
        }
        height.resize(field.height_m->size());
        for (int y = 0; y < field.size.y; ++y)
            for (int x = 0; x < field.size.x; ++x)
                height[std::size_t(x) * std::size_t(along) + std::size_t(y)] =
                    (*field.height_m)[std::size_t(y) * std::size_t(along_x ? along : across) + std::size_t(x)];
    }
};

// One azimuth as lines that close on the periodic tile: over its `along` texels they climb a whole number of rows.
struct SweepWay {
    bool along_x;  // the lines' larger component is x
    int sign;      // of it, seen from the receivers
    int climb;     // rows of the other component over one tile of the larger, seen from the receivers
    float azimuth; // [0, 2 pi)
    float step_m;  // between two crossings of texel lines

    SweepWay(const HeightField& field, float wished)
    {
        const glm::vec2 texel_m = field.tile_m / glm::vec2(field.size);
        const glm::vec2 d = glm::vec2(std::cos(wished), std::sin(wished)) / texel_m;
        along_x = std::abs(d.x) >= std::abs(d.y);
        const float major = along_x ? d.x : d.y, minor = along_x ? d.y : d.x;
        const int along = along_x ? field.size.x : field.size.y;
        sign = major >= 0 ? 1 : -1;
        climb = static_cast<int>(std::lround(minor / std::abs(major) * static_cast<float>(along)));
        const float rise = static_cast<float>(climb) / static_cast<float>(along);
        const glm::vec2 step = (along_x ? glm::vec2(sign, rise) : glm::vec2(rise, sign)) * texel_m;
        step_m = glm::length(step);
        azimuth = std::atan2(step.y, step.x);
        if (azimuth < 0) azimuth += 2 * pi;
    }
};

// Upper hull of what lies ahead on a line: nearest point last.
class HorizonStack
{
  public:
    explicit HorizonStack(std::size_t most) : points(most) {}
    void clear() { count = 0; }
    void push(float at, float height)
    {
        while (count > 1 && covered(points[count - 2], points[count - 1], at, height)) --count;
        points[count++] = {at, height};
    }
    // Greatest rise per step from a point that lies nearer than all of them. What it walks over is what the points that
    // it stands between will take off, so a walk around a loop costs no more than its points.
    float steepest(float at, float height) const
    {
        std::size_t k = count - 1;
        while (k > 0 && covered(points[k - 1], points[k], at, height)) --k;
        return (points[k].height - height) / (at - points[k].at);
    }

  private:
    struct Point {
        float at, height;
    };
    // Whether `near` is on or below the line from `far` to the point.
    static bool covered(Point far, Point near, float at, float height)
    {
        return (near.height - height) * (at - far.at) <= (far.height - height) * (at - near.at);
    }
    std::vector<Point> points;
    std::size_t count = 0;
};

// Horizons of one azimuth over the whole periodic field, as slopes. Lines through every row of texels, walked
// from far to near with the hull of what lies ahead (Timonen & Westerholm 2010, "Scalable height field
// self-shadowing"): the cost of a texel does not grow with how far it sees. Going round, lines meet others and close; a
// walk that starts at the highest point of such a loop has all that its receivers can see behind it after one lap, so
// periodicity is exact.
//   block  2: receivers in the middles of 2 x 2 texels, which see from 1.5 texels on; 1: in every texel, from 1 on.
//          Both take what the two lines beside them say, by their distances.
//   out    (along / block) * (across / block), `along` contiguous, in the field's own order
void sweep(const SweepField& field, const SweepWay& way, int block, std::vector<float>& out)
{
    const int n = field.along, rows = field.across, receivers = n / block;
    const int first_column = way.sign > 0 ? n - 1 : 0; // walking against the look
    out.assign(std::size_t(receivers) * std::size_t(rows / block), 0.0f);
    // Row of line b after i steps: b - i climb / n, modulo the rows: b + whole[i] + part[i].
    std::vector<int> whole(static_cast<std::size_t>(n));
    std::vector<float> part(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
        const std::int64_t moved = -std::int64_t(i) * way.climb;
        const std::int64_t floor_of = moved >= 0 ? moved / n : -((-moved + n - 1) / n);
        whole[std::size_t(i)] = static_cast<int>(((floor_of % rows) + rows) % rows);
        part[std::size_t(i)] = static_cast<float>(moved - floor_of * n) / static_cast<float>(n);
    }
    const int turn = wrapped(-way.climb, rows); // from a line to the one that carries it on
    const int loops = std::gcd(turn, rows), lines = rows / loops, total = lines * n;
    const float half_step = 0.5f * static_cast<float>(way.climb) / static_cast<float>(n);
    std::vector<float> heights(static_cast<std::size_t>(total));
    std::vector<int> line_of(static_cast<std::size_t>(lines));
    HorizonStack stack(heights.size() + static_cast<std::size_t>(block));
    for (int loop = 0; loop < loops; ++loop) {
        for (int l = 0, b = loop; l < lines; ++l, b = (b + turn) % rows) {
            line_of[std::size_t(l)] = b;
            float* to = heights.data() + std::ptrdiff_t(l) * n;
            for (int i = 0; i < n; ++i) {
                int row = b + whole[std::size_t(i)];
                row = row >= rows ? row - rows : row;
                const float* here = field.height.data() + first_column - way.sign * i;
                const float low = here[std::ptrdiff_t(row) * n];
                const float high = here[std::ptrdiff_t(row + 1 == rows ? 0 : row + 1) * n];
                to[i] = low + part[std::size_t(i)] * (high - low);
            }
        }
        const int highest = static_cast<int>(std::max_element(heights.begin(), heights.end()) - heights.begin());
        const int start = highest / block * block; // blocks begin at even steps
        stack.clear();
        for (int k = highest; k < start + block; ++k)
            stack.push(static_cast<float>(k - start), heights[std::size_t(k)]);
        for (int k = block; k <= total; k += block) {
            const int here = start + k < total ? start + k : start + k - total;
            const int i = here % n, b = line_of[std::size_t(here / n)];
            const float* height = heights.data() + here;
            const float at = static_cast<float>(k) + 0.5f * static_cast<float>(block - 1);
            const float level = block == 1 ? height[0] : 0.5f * (height[0] + height[1]);
            const float slope = std::max(stack.steepest(at, level), 0.0f) / way.step_m;
            for (int j = 0; j < block; ++j) stack.push(static_cast<float>(k + j), height[j]);
            const int receiver = (first_column - way.sign * i) / block;
            const auto put = [&](int row, float weight) {
                out[static_cast<std::size_t>(row * receivers + receiver)] += weight * slope;
            };
            int row = b + whole[std::size_t(i)];
            row = row >= rows ? row - rows : row;
            if (block == 1) {
                put(row, 1 - part[std::size_t(i)]);
                put(row + 1 == rows ? 0 : row + 1, part[std::size_t(i)]);
            } else { // receivers Y lie at 2 Y + 1/2, lines a row apart
                const float off = static_cast<float>(row) + part[std::size_t(i)] - half_step - 0.5f;
                const float nearest = std::floor(0.5f * off + 0.5f);
                put(wrapped(static_cast<int>(nearest), rows / 2), 1 - std::abs(off - 2 * nearest));
            }
        }
    }
}

// Planes of sines, one for each azimuth, as 16 bits: y rows of x.
struct Horizons {
    glm::ivec2 size;
    std::vector<float> azimuths;
    std::vector<std::vector<std::uint16_t>> sines;

    void at(std::size_t index, float* s) const
    {
        for (std::size_t j = 0; j < sines.size(); ++j) s[j] = static_cast<float>(sines[j][index]) * (1 / 65535.0f);
    }
};

Horizons sweep_all(const HeightField& field, int block)
{
    Horizons out;
    out.size = field.size / block;
    std::vector<SweepWay> ways;
    for (int j = 0; j < horizon_azimuths; ++j)
        ways.emplace_back(field, 2 * pi * (static_cast<float>(j) + 0.5f) / horizon_azimuths);
    for (const SweepWay& way : ways) out.azimuths.push_back(way.azimuth);
    out.sines.resize(ways.size());
    const SweepField along_x(field, true), along_y(field, false);
    tbb::parallel_for(std::size_t(0), ways.size(), [&](std::size_t j) {
        const SweepWay& way = ways[j];
        thread_local std::vector<float> plane;
        sweep(way.along_x ? along_x : along_y, way, block, plane);
        for (float& slope : plane) slope = sine_of_slope(slope);
        out.sines[j].resize(plane.size());
        const auto word = [](float s) { return static_cast<std::uint16_t>(std::min(s, 1.0f) * 65535.0f + 0.5f); };
        for (int y = 0; y < out.size.y; ++y)
            for (int x = 0; x < out.size.x; ++x)
                out.sines[j][std::size_t(y) * std::size_t(out.size.x) + std::size_t(x)] =
                    word(plane[way.along_x ? std::size_t(y) * std::size_t(out.size.x) + std::size_t(x)
                                           : std::size_t(x) * std::size_t(out.size.y) + std::size_t(y)]);
    });
    return out;
}

// ---- the fit

// knots = fit * horizons: (B^T B)^-1 B^T with the rows of the spline's basis at the swept azimuths, the same for every
// block.
using KnotFit = std::vector<std::array<float, horizon_azimuths>>;
KnotFit knot_fit(const std::vector<float>& azimuths, int knots)
{
    const std::size_t n = static_cast<std::size_t>(knots);
    std::vector<std::vector<double>> basis(horizon_azimuths, std::vector<double>(n, 0.0));
    for (std::size_t j = 0; j < horizon_azimuths; ++j) {
        const float octants = cloth::f32::cloth_horizon_azimuth({std::cos(azimuths[j]), std::sin(azimuths[j])});
        const double g = double(octants) * knots / 8;
        const int k = static_cast<int>(g) % knots;
        const double f = g - std::floor(g);
        basis[j][static_cast<std::size_t>(k)] += 1 - f;
        basis[j][static_cast<std::size_t>((k + 1) % knots)] += f;
    }
    // [B^T B | B^T]
    std::vector<std::vector<double>> system(n, std::vector<double>(n + horizon_azimuths, 0.0));
    for (std::size_t r = 0; r < n; ++r)
        for (std::size_t j = 0; j < horizon_azimuths; ++j) {
            for (std::size_t c = 0; c < n; ++c) system[r][c] += basis[j][r] * basis[j][c];
            system[r][n + j] = basis[j][r];
        }
    for (std::size_t pivot = 0; pivot < n; ++pivot) { // Gauss-Jordan; B^T B is positive definite
        const double scale = 1 / system[pivot][pivot];
        for (double& value : system[pivot]) value *= scale;
        for (std::size_t r = 0; r < n; ++r) {
            if (r == pivot) continue;
            const double factor = system[r][pivot];
            for (std::size_t c = 0; c < system[r].size(); ++c) system[r][c] -= factor * system[pivot][c];
        }
    }
    KnotFit fit(n);
    for (std::size_t k = 0; k < n; ++k)
        for (std::size_t j = 0; j < horizon_azimuths; ++j) fit[k][j] = static_cast<float>(system[k][n + j]);
    return fit;
}

} // namespace

glm::vec2 height_range(const HeightField& field)
{
    const auto [low, high] = std::minmax_element(field.height_m->begin(), field.height_m->end());
    return {*low, *high};
}

std::vector<glm::uvec2> horizon_knots(const HeightField& field, int knots)
{
    const Horizons horizons = sweep_all(field, 2);
    const KnotFit fit = knot_fit(horizons.azimuths, knots);
    const std::size_t words = static_cast<std::size_t>(knots / 8), row = static_cast<std::size_t>(horizons.size.x);
    std::vector<glm::uvec2> out(row * static_cast<std::size_t>(horizons.size.y) * words);
    tbb::parallel_for(std::size_t(0), static_cast<std::size_t>(horizons.size.y), [&](std::size_t Y) {
        float s[horizon_azimuths], fitted[8];
        for (std::size_t at = Y * row; at < (Y + 1) * row; ++at) {
            horizons.at(at, s);
            for (std::size_t part = 0; part < words; ++part) {
                for (std::size_t k = 0; k < 8; ++k) {
                    float sum = 0;
                    for (std::size_t j = 0; j < horizon_azimuths; ++j) sum += fit[8 * part + k][j] * s[j];
                    fitted[k] = sum;
                }
                out[at * words + part] = pack_knots(fitted); // clamps
            }
        }
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

namespace
{

// What a texel sees of the hemisphere: math.md 8.1 and 8.2, over slices between the swept azimuths' middles.
struct Seen {
    double omega = 0;            // solid angle
    glm::dvec3 mean;             // unit
    double gamma = 0;            // of the larger spread, about the mean, from cloth_frame's x [rad]
    double large = 0, small = 0; // eigenvalues of the covariance across the mean
};

class Slices
{
  public:
    explicit Slices(const std::vector<float>& azimuths)
    {
        const std::size_t n = azimuths.size();
        for (std::size_t j = 0; j < n; ++j) {
            const double two_pi = 2 * pi_d;
            const double before = double(azimuths[(j + n - 1) % n]) - (j == 0 ? two_pi : 0),
                         after = double(azimuths[(j + 1) % n]) + (j + 1 == n ? two_pi : 0);
            const double phi = double(azimuths[j]);
            slices.push_back({std::cos(phi), std::sin(phi), (after - before) / 2});
        }
    }
    Seen seen(const float* sines) const
    {
        glm::dvec3 sum(0);
        Seen out;
        double xx = 0, xy = 0, yy = 0, xz = 0, yz = 0, zz = 0;
        for (std::size_t j = 0; j < slices.size(); ++j) {
            const auto [c, n, width] = slices[j];
            const double s = double(sines[j]), s3 = s * s * s, r = std::sqrt(std::max(1 - s * s, 0.0));
            out.omega += width * (1 - s);
            const double across = width * (std::acos(std::min(s, 1.0)) - s * r) / 2;
            sum += glm::dvec3(across * c, across * n, width * (1 - s * s) / 2);
            const double h = width * (2.0 / 3.0 - s + s3 / 3), v = width * r * r * r / 3;
            xx += h * c * c, xy += h * c * n, yy += h * n * n, xz += v * c, yz += v * n, zz += width * (1 - s3) / 3;
        }
        out.mean = f64::cloth_unit_vector(sum, {0, 0, 1});
        const glm::dmat3 second(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        const f64::ClothFrame frame = f64::cloth_frame(out.mean);
        const double over = 1 / std::max(out.omega, 1e-6);
        const double uu = glm::dot(frame.x, second * frame.x) * over, uv = glm::dot(frame.x, second * frame.y) * over,
                     vv = glm::dot(frame.y, second * frame.y) * over;
        const double middle = (uu + vv) / 2, spread = std::hypot((uu - vv) / 2, uv);
        out.gamma = std::atan2(2 * uv, uu - vv) / 2;
        out.large = middle + spread, out.small = middle - spread;
        return out;
    }
    // Least-squares amplitude <V, A> / <A, A> of a Gaussian against the horizons (math.md 8.3), over rings of equal
    // solid angle.
    double amplitude(const f64::real4& axis, const f64::real4& shape, const float* sines) const
    {
        const f64::ClothFrame frame = f64::cloth_frame(glm::dvec3(axis));
        const glm::dvec3 mu(axis), x = frame.x * std::cos(axis.w) + frame.y * std::sin(axis.w), y = glm::cross(mu, x);
        double va = 0, aa = 0;
        constexpr int rings = 16;
        for (std::size_t j = 0; j < slices.size(); ++j) {
            const auto [c, n, width] = slices[j];
            for (int k = 0; k < rings; ++k) {
                const double z = (k + 0.5) / rings, r = std::sqrt(1 - z * z);
                const glm::dvec3 d(r * c, r * n, z);
                const double along = glm::dot(mu, d), dx = glm::dot(x, d), dy = glm::dot(y, d);
                const double a = along > 0 ? along * std::exp(-shape.x * dx * dx - shape.y * dy * dy) : 0;
                va += z > double(sines[j]) ? width * a : 0;
                aa += width * a * a;
            }
        }
        return va / std::max(aa, 1e-9);
    }

  private:
    struct Slice {
        double cosine, sine, width;
    };
    std::vector<Slice> slices;
};

// fit(texel, what it sees, its horizons, slices) for every texel.
template <class Fit> void fit_texels(const HeightField& field, Fit&& fit)
{
    const Horizons horizons = sweep_all(field, 1);
    const Slices slices(horizons.azimuths);
    const std::size_t row = static_cast<std::size_t>(field.size.x);
    tbb::parallel_for(std::size_t(0), static_cast<std::size_t>(field.size.y), [&](std::size_t y) {
        float s[horizon_azimuths];
        for (std::size_t at = y * row; at < (y + 1) * row; ++at) {
            horizons.at(at, s);
            fit(at, slices.seen(s), s, slices);
        }
    });
}

} // namespace

std::vector<glm::vec4> fit_asg(const HeightField& field, bool least_squares)
{
    std::vector<glm::vec4> records(2 * field.height_m->size());
    fit_texels(field, [&](std::size_t at, const Seen& seen, const float* s, const Slices& slices) {
        const f64::real4 axis(seen.mean, seen.gamma);
        f64::real4 shape(1 / (2 * std::max(seen.large, 1e-4)), 1 / (2 * std::max(seen.small, 1e-4)),
                         seen.omega > 1e-6 ? 1 : 0, 0);
        if (least_squares && shape.z > 0) shape.z = slices.amplitude(axis, shape, s);
        records[2 * at] = glm::vec4(axis);
        records[2 * at + 1] = glm::vec4(shape);
    });
    return records;
}

std::vector<glm::uvec2> fit_cap(const HeightField& field)
{
    std::vector<glm::uvec2> words(field.height_m->size());
    fit_texels(field, [&](std::size_t at, const Seen& seen, const float*, const Slices&) {
        // a_k = 2 sqrt(l_k), then both times the same factor: pi a_1 a_2 = omega (math.md 8.5).
        const double a1 = std::sqrt(std::max(seen.large, 1e-8)), a2 = std::sqrt(std::max(seen.small, 1e-8));
        const double scale = std::sqrt(seen.omega / (pi_d * a1 * a2));
        words[at] = pack_cap({seen.mean, seen.gamma}, {a1 * scale, a2 * scale});
    });
    return words;
}

} // namespace selvedge
