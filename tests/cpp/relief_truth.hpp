// tests/cpp/relief_truth.hpp: light on a height field, exactly: float64 rays against every bilinear patch they cross,
// its own normals, path tracing over all bounces. Shares no march, no visibility and no sampling with glsl/: the
// yardstick of selvedge-ingredients and of plies_test.cpp, which include it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>

#include "bake/pack.hpp"

namespace selvedge
{

// Random numbers of its own. PCG32, O'Neill 2014.
class TruthRandom
{
  public:
    explicit TruthRandom(std::uint64_t seed) : state(seed * 2 + 1)
    {
        next();
        state += 0x9e3779b97f4a7c15u ^ (seed << 17);
        next();
    }
    double uniform() // [0, 1)
    {
        return (double(next()) + 0.5) / 4294967296.0;
    }

  private:
    std::uint32_t next()
    {
        const std::uint64_t old = state;
        state = old * 6364136223846793005u + 1442695040888963407u;
        const auto x = static_cast<std::uint32_t>(((old >> 18) ^ old) >> 27);
        const auto turn = static_cast<std::uint32_t>(old >> 59);
        return (x >> turn) | (x << ((32 - turn) & 31));
    }
    std::uint64_t state;
};

// One side of a fabric: heights in metres at texel centres, bilinear between them, periodic.
class ReliefTruth
{
  public:
    struct Hit {
        glm::dvec2 texels; // of the front's grid: 0 is the tile's edge, centres at .5
        double height_m;
        glm::dvec3 normal; // of the patch, unit, z > 0
    };
    // What the sky above (radiance 1) and a directional light (irradiance 1 across the ray) send to the eye: from the
    // first surface, and over all bounces.
    struct Radiance {
        double sky_once = 0, sky_all = 0, sun_once = 0, sun_all = 0;
        double passes = 0; // the eye looks through a gap
    };

    ReliefTruth(const PackedFabric& fabric, int of_side)
        : cloth(fabric), side(of_side), size(fabric.size), heights(heights_m(fabric, of_side))
    {
        const auto [low, high] = std::minmax_element(heights.begin(), heights.end());
        lowest_m = double(*low), highest_m = double(*high);
        texel_m = glm::dvec2(fabric.tile_m) / glm::dvec2(size);
    }

    // The first patch that a ray meets from above, or nothing. `way` need not be unit; z may be of either sign, not 0.
    std::optional<Hit> trace(glm::dvec2 texels, double height_m, glm::dvec3 way) const
    {
        // In the grid of texel centres; z stays in metres, t counts metres along `way`.
        const glm::dvec2 q = texels - 0.5, d = glm::dvec2(way) / texel_m;
        double t = 0, x = q.x, y = q.y;
        std::int64_t cx = cell_of(x, d.x), cy = cell_of(y, d.y);
        for (int step = 0; step < step_limit; ++step) {
            const double z = height_m + t * way.z;
            if (way.z > 0 ? z > highest_m : z < lowest_m - 1e-9) return std::nullopt;
            const double to_x = d.x != 0 ? (double(d.x > 0 ? cx + 1 : cx) - q.x) / d.x : 1e300;
            const double to_y = d.y != 0 ? (double(d.y > 0 ? cy + 1 : cy) - q.y) / d.y : 1e300;
            double end = std::min(to_x, to_y);
            if (d.x == 0 && d.y == 0) end = (lowest_m - 1e-6 - height_m) / way.z;
            if (const std::optional<double> at = meet(cx, cy, q, height_m, d, way.z, t, end)) {
                x = q.x + *at * d.x, y = q.y + *at * d.y;
                return Hit{{x + 0.5, y + 0.5}, height_m + *at * way.z, normal_at(cx, cy, x, y)};
            }
            if (d.x == 0 && d.y == 0) return std::nullopt;
            t = end;
            if (to_x < to_y)
                cx += d.x > 0 ? 1 : -1;
            else
                cy += d.y > 0 ? 1 : -1;
        }
        return std::nullopt; // all but parallel to the cloth: beyond 10^5 patches
    }

    bool occluded(glm::dvec2 texels, double height_m, glm::dvec3 way) const
    {
        return trace(texels, height_m, way).has_value();
    }

    double height_at(glm::dvec2 texels) const
    {
        const glm::dvec2 q = texels - 0.5;
        const auto cx = static_cast<std::int64_t>(std::floor(q.x)), cy = static_cast<std::int64_t>(std::floor(q.y));
        const Patch p = patch(cx, cy);
        const double a = q.x - double(cx), b = q.y - double(cy);
        return p.h + a * p.hx + b * p.hy + a * b * p.hxy;
    }

    // The point that the eye sees along the line through `tile` on the mid-plane.
    std::optional<Hit> seen(glm::dvec2 tile, glm::dvec3 o) const
    {
        const glm::dvec2 texels = tile * glm::dvec2(size) + glm::dvec2(o) / o.z * (highest_m + 1e-7) / texel_m;
        return trace(texels, highest_m + 1e-7, -o);
    }

    // One path. `back` is the other side's field, for what is seen through gaps.
    Radiance path(const ReliefTruth& back, glm::dvec2 tile, glm::ivec2 base, glm::dvec3 o, glm::dvec3 sun,
                  TruthRandom& random) const
    {
        Radiance out;
        std::optional<Hit> hit = seen(tile, o);
        if (!hit) return out;
        double carried = 1;
        for (int bounce = 0; bounce < 256; ++bounce) {
            const Surface surface = surface_at(*hit, base);
            if (surface.gap && o.z > 0 &&
                !back.occluded(hit->texels, lift_m, {-o.x, -o.y, o.z})) { // the same line, in the mirrored frame
                if (bounce == 0) out.passes = 1;
                break;
            }
            const glm::dvec3 n = surface.normal;
            if (glm::dot(n, o) <= 0) break; // the flank of a gap, seen from below its plane
            const glm::dvec3 at(hit->texels, hit->height_m + lift_m);
            if (glm::dot(n, sun) > 0 && !occluded(glm::dvec2(at), at.z, sun)) {
                const double light = carried * value(surface, sun, o);
                out.sun_all += light;
                if (bounce == 0) out.sun_once += light;
            }
            // A direction with cosine density about the patch's normal.
            const double r2 = random.uniform(), phi = 2 * pi * random.uniform();
            const cloth::f64::ClothFrame frame = cloth::f64::cloth_frame(n);
            const glm::dvec3 i =
                std::sqrt(r2) * (std::cos(phi) * frame.x + std::sin(phi) * frame.y) + std::sqrt(1 - r2) * n;
            const double c = glm::dot(n, i);
            if (c <= 0 || i.z == 0) break;
            carried *= value(surface, i, o) * pi / c;
            const std::optional<Hit> next = trace(glm::dvec2(at), at.z, i);
            if (!next) {
                if (i.z > 0) out.sky_all += carried;
                if (i.z > 0 && bounce == 0) out.sky_once += carried;
                break;
            }
            if (bounce >= 3) { // roulette
                const double go_on = std::min(carried, 0.95);
                if (random.uniform() >= go_on) break;
                carried /= go_on;
            }
            hit = next;
            o = -i;
        }
        return out;
    }

    glm::dvec2 texel_m;
    double lift_m = 1e-9; // off the patch that a ray starts from; a texel is 10^-5 m

  private:
    static constexpr double pi = 3.14159265358979323846;
    static constexpr int step_limit = 100000;

    struct Patch {
        double h, hx, hy, hxy; // h + a hx + b hy + a b hxy, a and b in [0, 1]
    };
    struct Surface {
        glm::dvec3 normal, tangent;
        const cloth::f32::ClothYarn* yarn;
        bool gap;
    };

    static std::int64_t cell_of(double x, double way)
    {
        const double cell = std::floor(x);
        return static_cast<std::int64_t>(cell) - (x == cell && way < 0 ? 1 : 0);
    }
    std::size_t index(std::int64_t x, std::int64_t y) const
    {
        const std::int64_t w = size.x, h = size.y;
        return static_cast<std::size_t>(((y % h + h) % h) * w + (x % w + w) % w);
    }
    Patch patch(std::int64_t cx, std::int64_t cy) const
    {
        const double a = double(heights[index(cx, cy)]), b = double(heights[index(cx + 1, cy)]),
                     c = double(heights[index(cx, cy + 1)]), d = double(heights[index(cx + 1, cy + 1)]);
        return {a, b - a, c - a, d - b - c + a};
    }
    glm::dvec3 normal_at(std::int64_t cx, std::int64_t cy, double x, double y) const
    {
        const Patch p = patch(cx, cy);
        const double a = x - double(cx), b = y - double(cy);
        return glm::normalize(glm::dvec3(-(p.hx + b * p.hxy) / texel_m.x, -(p.hy + a * p.hxy) / texel_m.y, 1.0));
    }
    // First t in [t0, t1] where the ray comes from above the patch to it: a quadratic.
    std::optional<double> meet(std::int64_t cx, std::int64_t cy, glm::dvec2 q, double z, glm::dvec2 d, double dz,
                               double t0, double t1) const
    {
        const Patch p = patch(cx, cy);
        const double a0 = q.x - double(cx), b0 = q.y - double(cy);
        // clearance(t) = A t^2 + B t + C
        const double A = -p.hxy * d.x * d.y, B = dz - p.hx * d.x - p.hy * d.y - p.hxy * (a0 * d.y + b0 * d.x),
                     C = z - p.h - p.hx * a0 - p.hy * b0 - p.hxy * a0 * b0;
        const auto clearance = [&](double t) { return (A * t + B) * t + C; };
        double roots[2];
        int count = 0;
        const double inside = B * B - 4 * A * C;
        if (std::abs(A) < 1e-14 * std::abs(B)) {
            if (B != 0) roots[count++] = -C / B;
        } else if (inside >= 0) {
            const double w = -0.5 * (B + std::copysign(std::sqrt(inside), B));
            if (A != 0) roots[count++] = w / A;
            if (w != 0) roots[count++] = C / w;
            if (count == 2 && roots[0] > roots[1]) std::swap(roots[0], roots[1]);
        }
        const double slack = 1e-12 * (1 + std::abs(t1));
        for (int k = 0; k < count; ++k)
            if (roots[k] > t0 - slack && roots[k] <= t1 + slack && roots[k] > 0 && 2 * A * roots[k] + B < 0)
                return roots[k];
        // Below the patch all along: the ray slipped through the seam before it.
        if (clearance(t0) < -1e-8 * texel_m.x && clearance(t1) < 0 && t0 > 0) return t0;
        return std::nullopt;
    }

    Surface surface_at(const Hit& hit, glm::ivec2 base) const
    {
        const auto x = static_cast<std::int64_t>(std::floor(hit.texels.x)),
                   y = static_cast<std::int64_t>(std::floor(hit.texels.y));
        const Texel texel = unpack_texel(cloth.side[side].texels[index(x, y)]);
        const cloth::f32::ClothYarn& yarn = cloth.yarns[static_cast<std::size_t>(texel.yarn)];
        const glm::dvec3 n = texel.gap ? glm::dvec3(0, 0, 1) : hit.normal;
        const double c = std::cos(double(texel.azimuth)), s = std::sin(double(texel.azimuth));
        // Along the azimuth in the tangent plane, turned by the fibres' twist and its irregularity.
        const glm::dvec3 along = glm::normalize(glm::dvec3(c, s, -(n.x * c + n.y * s) / n.z));
        const auto tile_of = [](std::int64_t i, std::int64_t count) {
            return static_cast<int>(i >= 0 ? i / count : -((-i + count - 1) / count));
        };
        const glm::ivec2 xy(static_cast<int>((x % size.x + size.x) % size.x),
                            static_cast<int>((y % size.y + size.y) % size.y));
        const cloth::f32::ClothMaps maps = maps_of(cloth);
        const glm::dvec2 twist =
            cloth::f32::cloth_twist(maps, yarn.twist, xy, base + glm::ivec2(tile_of(x, size.x), tile_of(y, size.y)));
        return {n, twist.x * along + (side == 0 ? 1 : -1) * twist.y * glm::cross(n, along), &yarn, texel.gap};
    }

    // Reflection at a point, value with cosine: slab and diffuse, math.md 3.4 and 4.1, green.
    static double value(const Surface& surface, glm::dvec3 i, glm::dvec3 o)
    {
        namespace f64 = cloth::f64;
        const cloth::f32::ClothYarn& yarn = *surface.yarn;
        const double c_i = glm::dot(surface.normal, i), c_o = glm::dot(surface.normal, o), alpha = double(yarn.alpha_r);
        const double d = f64::cloth_sggx_d_half(i, o, surface.tangent, alpha);
        const double sigma_i = f64::cloth_sggx_sigma(i, surface.tangent, alpha),
                     sigma_o = f64::cloth_sggx_sigma(o, surface.tangent, alpha);
        return double(yarn.albedo_r.y) *
                   f64::cloth_slab_reflect(d, sigma_i, sigma_o, c_i, c_o, double(yarn.thickness)) / c_o +
               double(yarn.diffuse_r.y) * c_i / pi;
    }

    const PackedFabric& cloth;
    int side;
    glm::ivec2 size;
    std::vector<float> heights; // [m]
    double lowest_m, highest_m;
};

} // namespace selvedge
