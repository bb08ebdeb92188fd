// tests/cpp/march_test.cpp: the march of the view ray against steps so small that nothing can be missed.
#include <algorithm>
#include <cmath>
#include <random>

#include <catch2/catch.hpp>

#include "bake/bake.hpp"
#include "bake/weaves.hpp"

namespace selvedge
{
namespace
{

namespace f64 = cloth::f64;

// A relief with cliffs: what a march could step over.
struct Relief {
    PackedFabric fabric;
    cloth::f32::ClothMaps narrow;
    f64::ClothMaps maps;

    Relief()
    {
        BakeOptions options;
        options.resolution = 256;
        options.use_cache = false;
        Fabric spec;
        spec.draft = builtin_weave("twill 2/2");
        fabric = bake_fabric(spec, options);
        narrow = maps_of(fabric);
        maps.size = narrow.size;
        for (int side = 0; side < 2; ++side) maps.heights[side] = narrow.heights[side];
        maps.tile_m = glm::dvec2(narrow.tile_m);
        maps.height_low = glm::dvec2(narrow.height_low);
        maps.height_high = glm::dvec2(narrow.height_high);
    }
};

// The first flat texel that the ray goes below, in steps of a fiftieth of a texel; or the point one step before that:
// at a wall between two texels the other one.
glm::dvec2 slow_march(const f64::ClothMaps& maps, int side, glm::dvec2 tile, glm::dvec3 o, int before = 0)
{
    const double low = maps.height_low[side], high = maps.height_high[side];
    const glm::dvec2 run = glm::dvec2(o) / o.z / maps.tile_m;
    const glm::dvec2 texels = glm::abs(run) * (high - low) * glm::dvec2(maps.size);
    const int steps = int(std::ceil(std::max({texels.x, texels.y, 1.0}) * 50));
    for (int k = 0; k <= steps; ++k) {
        const double z = high + (low - high) * k / steps;
        const glm::dvec2 at = tile + run * z;
        const glm::ivec2 xy = f64::cloth_texel_at(maps, at);
        if (low + (high - low) * f64::cloth_fetch_height(maps, side, xy) / 65535.0 >= z)
            return at - run * ((low - high) / steps * before);
    }
    return tile + run * low;
}

} // namespace

TEST_CASE("the march finds what the eye sees, at every angle and on both sides")
{
    const Relief relief;
    std::mt19937 random(7);
    std::uniform_real_distribution<double> unit(0, 1);
    const auto height = [&](int side, glm::dvec2 at) {
        return f64::cloth_fetch_height(relief.maps, side, f64::cloth_texel_at(relief.maps, at)) / 65535.0;
    };
    for (const double angle : {0.0, 30.0, 60.0, 75.0, 85.0})
        for (const int side : {0, 1}) {
            int near = 0;
            double higher = 0, squares = 0;
            constexpr int rays = 4000;
            for (int k = 0; k < rays; ++k) {
                const double theta = glm::radians(angle), phi = 2 * f64::cloth_pi * unit(random);
                const glm::dvec3 o(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta));
                const glm::dvec2 tile(unit(random), unit(random));
                // In another repeat: it must be the same texel of that repeat, or the twist noise would repeat.
                const glm::dvec2 repeat(-3, 5);
                const glm::dvec2 got = f64::cloth_march(relief.maps, side, tile + repeat, o, unit(random)) - repeat;
                const glm::dvec2 truth = slow_march(relief.maps, side, tile, o);
                const glm::dvec2 apart = got - truth;
                near += std::abs(apart.x) * relief.maps.size.x <= 1 && std::abs(apart.y) * relief.maps.size.y <= 1;
                // Of a wall each of its texels is seen half the time.
                const double expected =
                    (height(side, truth) + height(side, slow_march(relief.maps, side, tile, o, 1))) / 2;
                const double error = height(side, got) - expected;
                higher += error / rays;
                squares += error * error / rays;
            }
            // A ray may slip past an edge that it touches for less than a step. That must not make the cloth seen
            // deeper.
            INFO("angle " << angle << ", side " << side << ": " << near << " of " << rays
                          << " within a texel, higher by " << higher << ", rms " << std::sqrt(squares));
            CHECK(near >= rays * (angle > 80 ? 0.75 : 0.95)); // at 85 degrees steps are longer: cloth_march_steps
            CHECK(std::abs(higher) < 0.006);
        }
}

} // namespace selvedge
