// The bake: tubes to maps, horizons, packing, energy, cache. Catch2. Where a closed form exists it is the yardstick.
#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <unistd.h>

#include <tbb/global_control.h>

#include "bake/bake.hpp"
#include "bake/cache.hpp"
#include "bake/energy.hpp"
#include "bake/error.hpp"
#include "bake/image.hpp"
#include "bake/maps.hpp"
#include "bake/params.hpp"
#include "bake/visibility.hpp"
#include "bake/weaves.hpp"

using namespace selvedge;

namespace
{

constexpr float pi = 3.14159265358979f;

Fabric weave(const std::string& pattern, int plies = 2)
{
    Fabric fabric;
    fabric.name = pattern;
    fabric.draft = builtin_weave(pattern);
    fabric.warp.plies = fabric.weft.plies = plies;
    return fabric;
}

PackedFabric baked(const Fabric& fabric)
{
    BakeOptions options;
    options.use_cache = false;
    return bake_fabric(fabric, options);
}

// A straight tube along y at x = middle of a square tile.
PlyModel straight_tube(float tile_m, float radius_m, float aspect)
{
    PlyTube tube;
    tube.aspect = aspect;
    tube.warp = true;
    for (int i = 0; i <= 8; ++i) tube.points.push_back({{tile_m / 2, tile_m * static_cast<float>(i) / 8, 0}, radius_m});
    return {glm::vec2(tile_m), {tube}};
}

// Mean over tile and azimuths of A_p = max(0, o.N) V, over o.z: 1 for a closed surface (math.md 6.2).
float visible_area(const PackedFabric& fabric, int side, float degrees)
{
    const PackedSide& packed = fabric.side[side];
    const std::vector<float> heights = heights_m(fabric, side);
    const HeightField field{fabric.size, fabric.tile_m, &heights};
    const glm::vec2 range_m = height_range(field);
    const float z = std::cos(degrees * pi / 180), r = std::sin(degrees * pi / 180);
    double sum = 0;
    int count = 0;
    for (int a = 0; a < 8; ++a) {
        const float azimuth = 2 * pi * (static_cast<float>(a) + 0.3f) / 8;
        for (int y = a % 3; y < fabric.size.y; y += 3)
            for (int x = a % 4; x < fabric.size.x; x += 4, ++count) {
                const glm::vec2 slope =
                    unpack_texel(packed.texels[static_cast<std::size_t>(y * fabric.size.x + x)]).slope;
                const float area = z - r * (std::cos(azimuth) * slope.x + std::sin(azimuth) * slope.y);
                if (area > 0 && z > march_horizon(field, range_m, glm::vec2(x, y) + 0.5f, azimuth))
                    sum += static_cast<double>(area / z);
            }
    }
    return static_cast<float>(sum / count);
}

class CacheFolder
{
  public:
    CacheFolder()
        : path((std::filesystem::temp_directory_path() / ("selvedge-cache-" + std::to_string(::getpid()))).string())
    {
        std::filesystem::remove_all(path);
        ::setenv("SELVEDGE_CACHE", path.c_str(), 1);
    }
    ~CacheFolder()
    {
        ::unsetenv("SELVEDGE_CACHE");
        std::filesystem::remove_all(path);
    }
    std::string only_file() const
    {
        std::string found;
        for (const auto& entry : std::filesystem::directory_iterator(path)) {
            REQUIRE(found.empty());
            found = entry.path().string();
        }
        return found;
    }
    const std::string path;
};

bool same_words(const PackedFabric& a, const PackedFabric& b)
{
    bool same = a.size == b.size;
    for (int s = 0; s < 2; ++s)
        same = same && a.side[s].texels == b.side[s].texels && a.side[s].horizons == b.side[s].horizons &&
               a.side[s].slope_mips == b.side[s].slope_mips && a.side[s].heights == b.side[s].heights &&
               a.side[s].words == b.side[s].words && a.side[s].asg == b.side[s].asg;
    return same;
}

} // namespace

TEST_CASE("texels keep what is packed into them")
{
    Texel texel;
    texel.slope = {-1.25f, 3.5f};
    texel.azimuth = 2.5f;
    texel.yarn = 127;
    texel.gap = true;
    texel.irradiance = 0.6f;
    const Texel got = unpack_texel(pack_texel(texel));
    CHECK(got.slope.x == Approx(-1.25f).margin(4.0 / 32767 / 2));
    CHECK(got.slope.y == Approx(3.5f).margin(4.0 / 32767 / 2));
    CHECK(got.azimuth == Approx(2.5f).margin(3.15 / 65536));
    CHECK(got.yarn == 127);
    CHECK(got.gap);
    CHECK(got.irradiance == Approx(0.6f).margin(0.5 / 255 + 1e-6));
    // An azimuth that rounds up to pi is 0: t and -t are one direction.
    texel.azimuth = 3.1415925f;
    CHECK(unpack_texel(pack_texel(texel)).azimuth == 0);
    CHECK(unpack_slope(pack_slope({-9, 9})) == glm::vec2(-4, 4));
    const float knots[8] = {0, 0.1f, 0.2f, 0.4f, 0.6f, 0.8f, 1, 2};
    float again[8];
    unpack_knots(pack_knots(knots), again);
    for (int k = 0; k < 8; ++k) CHECK(again[k] == Approx(std::min(knots[k], 1.0f)).margin(0.5 / 255 + 1e-6));
    CHECK((pack_knots(knots).x & 255u) == 0u); // knot 0 is the lowest byte
}

TEST_CASE("a straight tube projects to its circle, front and back")
{
    const float aspect = GENERATE(1.0f, 0.4f);
    const FabricMaps maps = project_plies(straight_tube(1, 0.3f, aspect), {128, 64}, 4);
    int gaps = 0;
    for (int x = 0; x < 128; ++x) {
        const std::size_t i = static_cast<std::size_t>(20 * 128 + x);
        const float across = (static_cast<float>(x) + 0.5f) / 128 - 0.5f;
        gaps += maps.gap[i];
        if (std::abs(across) < 0.2f) {
            const float height = aspect * std::sqrt(0.09f - across * across);
            for (const SideMaps& side : maps.side) {
                CHECK(side.height_m[i] == Approx(height).epsilon(2e-3));
                CHECK(side.slope[i].x == Approx(-aspect * aspect * across / height).margin(2e-2));
                CHECK(std::abs(side.slope[i].y) < 1e-3f);
            }
        }
        for (const SideMaps& side : maps.side) CHECK(side.azimuth[i] == Approx(pi / 2).margin(1e-4));
    }
    CHECK(gaps / 128.0 == Approx(0.4).margin(1.01 / 128)); // 1 - 2 r / p
}

TEST_CASE("a straight race-track projects to its rectangle between two half circles")
{
    PlyModel model = straight_tube(1, 0.1f, 1);
    model.tubes[0].flat_m = {0.2f, 0};
    const FabricMaps maps = project_plies(model, {128, 64}, 4);
    int gaps = 0;
    for (int x = 0; x < 128; ++x) {
        const std::size_t i = static_cast<std::size_t>(20 * 128 + x);
        gaps += maps.gap[i];
        const float beyond = std::max(std::abs((static_cast<float>(x) + 0.5f) / 128 - 0.5f) - 0.2f, 0.0f);
        if (beyond < 0.07f)
            for (const SideMaps& side : maps.side)
                CHECK(side.height_m[i] == Approx(std::sqrt(0.01f - beyond * beyond)).epsilon(5e-3));
    }
    CHECK(gaps / 128.0 == Approx(0.4).margin(1.01 / 128));
}

TEST_CASE("a leaning, rising tube drawn out is all of its copies together")
{
    // Two plies of a yarn that rises and falls: by definition of the race-track, and by copies that are round.
    Fabric fabric = weave("plain 1/1", 2);
    for (YarnSpec* yarn : {&fabric.warp, &fabric.weft}) yarn->section = YarnSection::racetrack, yarn->aspect = 0.45f;
    const WovenPlan plan = plan_woven(fabric, 128);
    PlyModel drawn = wind_plies(plan.tile_m, weave_yarns(fabric, plan));
    drawn.tubes.resize(2); // the first end
    REQUIRE(drawn.tubes[0].flat_m.x > 0);
    REQUIRE(drawn.tubes[0].aspect == 1);
    PlyModel copies = drawn;
    copies.tubes.clear();
    for (const PlyTube& tube : drawn.tubes)
        for (int k = -100; k <= 100; ++k) {
            PlyTube copy = tube;
            copy.flat_m = {0, 0};
            const glm::vec3 by(tube.flat_m * static_cast<float>(k) / 100.0f, 0);
            for (PlyPoint& point : copy.points) point.centre_m += by;
            copy.before_m = *tube.before_m + by, copy.after_m = *tube.after_m + by;
            copies.tubes.push_back(copy);
        }
    const FabricMaps a = project_plies(drawn, plan.size, 4), b = project_plies(copies, plan.size, 4);
    int other_gaps = 0;
    double worst = 0, sum = 0;
    for (std::size_t i = 0; i < a.gap.size(); ++i) {
        other_gaps += a.gap[i] != b.gap[i] ? 1 : 0;
        for (int side = 0; side < 2; ++side) {
            const double apart =
                static_cast<double>(std::abs(a.side[side].height_m[i] - b.side[side].height_m[i]) / 0.0002f);
            worst = std::max(worst, apart), sum += apart;
        }
    }
    // Of the half width. The copies stand 1/100 of its flat part apart, and a ray may meet one more or less of them.
    CHECK(other_gaps == 0);
    CHECK(worst < 0.03);
    CHECK(sum / static_cast<double>(a.gap.size()) < 5e-4);
}

TEST_CASE("at a crossing race-tracks touch over their flat parts, ellipses do not")
{
    for (const YarnSection section : {YarnSection::ellipse, YarnSection::racetrack}) {
        Fabric fabric = weave("plain 1/1", 1);
        for (YarnSpec* yarn : {&fabric.warp, &fabric.weft})
            yarn->section = section, yarn->aspect = 0.4f, yarn->width_m = 0.0004f;
        const WovenPlan plan = plan_woven(fabric, 256);
        const std::vector<YarnPath> yarns = weave_yarns(fabric, plan);
        const auto of = [&](bool warp) {
            std::vector<YarnPath> some;
            for (const YarnPath& yarn : yarns)
                if (yarn.warp == warp) some.push_back(yarn);
            return project_plies(wind_plies(plan.tile_m, some), plan.size, 4);
        };
        const FabricMaps ends = of(true), picks = of(false);
        // Lower side of the upper yarn over the upper side of the lower one, around the crossing of end 1 and pick 1.
        const bool warp_up = plan.repeat.warp_on_top(1, 1);
        const FabricMaps &upper = warp_up ? ends : picks, &lower = warp_up ? picks : ends;
        const float texel_m = plan.tile_m.x / 256;
        const int middle = static_cast<int>(1.5f * 0.0005f / texel_m);
        const auto room = [&](int dx, int dy) {
            const std::size_t i = static_cast<std::size_t>((middle + dy) * 256 + middle + dx);
            return -upper.side[1].height_m[i] - lower.side[0].height_m[i];
        };
        const int flat = static_cast<int>(0.5f * (1 - 0.4f) * 0.0004f / texel_m) - 3; // chords cut the corner beyond
        for (const int dx : {-flat, 0, flat})
            for (const int dy : {-flat, 0, flat}) {
                INFO("section " << static_cast<int>(section) << " at " << dx << ", " << dy);
                if (section == YarnSection::racetrack)
                    CHECK(std::abs(room(dx, dy)) < 0.005f * 0.00016f);
                else if (dx != 0 || dy != 0)
                    CHECK(std::abs(room(dx, dy)) > 0.05f * 0.00016f);
            }
    }
}

TEST_CASE("tex and fibre give the width whose section holds the fibres")
{
    YarnSpec yarn;
    yarn.fibre = "cotton", yarn.plies = 1, yarn.aspect = 1;
    // Peirce: a cotton yarn of N tex has 1.1e-3 N mm^2: 20 tex, 0.167 mm.
    CHECK(width_of_tex(yarn, 20) == Approx(std::sqrt(4 * 20 * 1.1e-9 / 3.14159265)).epsilon(0.005));
    const float round = width_of_tex(yarn, 20);
    yarn.section = YarnSection::racetrack; // of aspect 1: a circle
    CHECK(width_of_tex(yarn, 20) == Approx(round));
    yarn.aspect = 0.3f; // area w h - (1 - pi / 4) h^2
    const float w = width_of_tex(yarn, 20), h = 0.3f * w;
    CHECK(w * h - (1 - pi / 4) * h * h == Approx(pi / 4 * round * round));
    yarn.section = YarnSection::ellipse;
    CHECK(0.3f * width_of_tex(yarn, 20) * width_of_tex(yarn, 20) == Approx(round * round));
    // Two plies in contact: each a circle of half the tex, the yarn as wide as both, less how much they flatten.
    yarn.aspect = 1, yarn.plies = 2;
    CHECK(width_of_tex(yarn, 20) == Approx(round / std::sqrt(2.0f) / ply_radii(2).x));
}

TEST_CASE("light through parallel cylinders ends where their silhouettes meet")
{
    // math.md 5.2: T_d = max(0, 1 - 2 r / (p cos theta)), through front and back horizons of gap points alone.
    const FabricMaps maps = project_plies(straight_tube(1, 0.35f, 1), {512, 4}, 4);
    const auto passed = [&](float degrees) {
        const float z = std::cos(degrees * pi / 180);
        int clear = 0;
        for (int x = 0; x < 512; ++x) {
            if (!maps.gap[static_cast<std::size_t>(x)]) continue;
            const glm::vec2 at(static_cast<float>(x) + 0.5f, 0.5f);
            bool open = true;
            for (int side = 0; side < 2; ++side) // the ray leaves in front to +x and behind to -x
                open = open && z > march_horizon({maps.size, maps.tile_m, &maps.side[side].height_m}, {0, 0.35f}, at,
                                                 side == 0 ? 0 : pi);
            clear += open ? 1 : 0;
        }
        return clear / 512.0;
    };
    // The field is no steeper than 4: a ramp stands on the yarn's edge, and less than 1 % of the pitch is open too
    // much.
    CHECK(passed(0) == Approx(0.3).margin(0.003));
    CHECK(passed(20) == Approx(1 - 0.7 / std::cos(20 * 0.0174533)).margin(0.01));
    CHECK(passed(40) == Approx(1 - 0.7 / std::cos(40 * 0.0174533)).margin(0.01));
    CHECK(passed(50) == 0);
}

TEST_CASE("gap texels carry the nearest yarn and nothing of a surface")
{
    Fabric fabric = weave("plain 1/1", 1);
    fabric.warp.width_m = fabric.weft.width_m = 0.0002f;
    const PackedFabric packed = baked(fabric);
    REQUIRE(packed.has_gaps);
    CHECK(packed.gap_cover == Approx(0.36).margin(0.01));
    CHECK(packed.warp_cover + packed.weft_cover + packed.gap_cover == Approx(1));
    for (int s = 0; s < 2; ++s)
        for (std::size_t i = 0; i < packed.side[s].texels.size(); ++i) {
            const Texel texel = unpack_texel(packed.side[s].texels[i]);
            if (!texel.gap) continue;
            CHECK(texel.slope == glm::vec2(0));
            const PackedSide& side = packed.side[s];
            CHECK(std::abs(height_m(side, i)) <= (side.height_range_m.y - side.height_range_m.x) / 65535);
            CHECK(unpack_texel(packed.side[1 - s].texels[i]).gap);
            // Between two ends the ends are nearer than the picks, and the other way round.
            const float fx = std::abs(std::fmod(static_cast<float>(i % 256) + 0.5f, 64.0f) - 32),
                        fy = std::abs(std::fmod(static_cast<float>(i / 256) + 0.5f, 64.0f) - 32);
            if (std::abs(fx - fy) > 2) CHECK((texel.yarn == 0) == (fx < fy));
        }
}

TEST_CASE("slopes agree with heights and leave no mean over the tile")
{
    for (const char* pattern : {"plain 1/1", "twill 2/2", "satin 5"}) {
        INFO(pattern);
        const PackedFabric packed = baked(weave(pattern));
        for (const PackedSide& side : packed.side) {
            CHECK(side.slope_mips.size() == slope_level_offset(packed.size, slope_level_count(packed.size)));
            const glm::vec2 top = unpack_slope(side.slope_mips.back());
            CHECK(std::abs(top.x) < 1e-3f);
            CHECK(std::abs(top.y) < 1e-3f);
            // Nowhere steeper than the limit, over the seam either (chamfer distances are up to 2.8 % long, the blur
            // mends most).
            const glm::vec2 texel_m = packed.tile_m / glm::vec2(packed.size);
            float steepest = 0;
            for (int y = 0; y < packed.size.y; ++y)
                for (int x = 0; x < packed.size.x; ++x) {
                    const auto height = [&](int i, int j) {
                        return height_m(
                            side, static_cast<std::size_t>((j % packed.size.y) * packed.size.x + i % packed.size.x));
                    };
                    steepest = std::max({steepest, std::abs(height(x + 1, y) - height(x, y)) / texel_m.x,
                                         std::abs(height(x, y + 1) - height(x, y)) / texel_m.y});
                }
            CHECK(steepest < 1.1f * slope_limit);
        }
    }
}

TEST_CASE("the visible projected area is that of the plane")
{
    // math.md 6.2 with exact horizons. What remains is the zeroed slope of gap texels and half-texel sampling.
    for (const char* pattern : {"plain 1/1", "twill 2/2", "satin 5"})
        for (const int plies : {1, 2}) {
            Fabric fabric = weave(pattern, plies);
            if (std::string(pattern) == "satin 5") fabric.warp.section = YarnSection::racetrack;
            const PackedFabric packed = baked(fabric);
            for (int side = 0; side < 2; ++side)
                for (const float degrees : {0.0f, 30.0f, 60.0f, 75.0f}) {
                    const float area = visible_area(packed, side, degrees);
                    INFO(pattern << ", " << plies << " plies, side " << side << ", " << degrees << " deg: " << area);
                    CHECK(area == Approx(1).margin(degrees < 70 ? 0.02 : 0.03));
                }
        }
}

TEST_CASE("the back of a plain weave is its front, one thread on")
{
    const PackedFabric packed = baked(weave("plain 1/1", 1));
    const int step = packed.size.x / 4;
    float worst = 0;
    for (int y = 0; y < packed.size.y; ++y)
        for (int x = 0; x < packed.size.x; ++x) {
            const float front =
                height_m(packed.side[0], static_cast<std::size_t>(y * packed.size.x + (x + step) % packed.size.x));
            worst = std::max(
                worst, std::abs(front - height_m(packed.side[1], static_cast<std::size_t>(y * packed.size.x + x))));
        }
    CHECK(worst < 0.02f * packed.side[0].height_range_m.y);
}

TEST_CASE("a side that is the other's mirror image is not baked twice")
{
    // The same weaves with yarns of different types or of two plies, and those whose faces differ, have two sides.
    const auto shift = [](const Fabric& fabric) { return baked(fabric).back_shift; };
    for (const char* pattern : {"plain 1/1", "twill 2/2", "basket 2/2"}) CHECK(shift(weave(pattern, 1)).has_value());
    for (const char* pattern : {"twill 1/3", "satin 5"}) CHECK_FALSE(shift(weave(pattern, 1)).has_value());
    CHECK_FALSE(shift(weave("plain 1/1", 2)).has_value());
    Fabric coloured = weave("plain 1/1", 1);
    coloured.use_draft_colours = true;
    coloured.draft.colours = {glm::vec3(0.1f), glm::vec3(0.9f)};
    for (std::size_t e = 0; e < coloured.draft.ends.size(); ++e) coloured.draft.ends[e].colour = int(e % 2);
    const std::optional<glm::ivec2> along_the_weft = shift(coloured);
    if (along_the_weft) CHECK(along_the_weft->x % (baked(coloured).size.x / 2) == 0); // ends keep their colours

    // What the front says of the back is what its own projection shows: the same yarns, gaps and heights.
    Fabric fabric = weave("twill 2/2", 1);
    const PackedFabric packed = baked(fabric);
    const FabricMaps maps = project_plies(
        wind_plies(packed.tile_m, weave_yarns(fabric, plan_woven(fabric, fabric.resolution))), packed.size, 4);
    int wrong_yarn = 0;
    double squares = 0;
    for (std::size_t i = 0; i < maps.gap.size(); ++i) {
        const Texel texel = unpack_texel(packed.side[1].texels[i]);
        CHECK(texel.gap == (maps.gap[i] != 0));
        wrong_yarn += packed.type_of(texel.yarn) != maps.side[1].yarn[i] ? 1 : 0;
        const double off = double(height_m(packed.side[1], i) - maps.side[1].height_m[i]);
        squares += off * off;
    }
    const glm::vec2 range = packed.side[1].height_range_m;
    CHECK(wrong_yarn < int(maps.gap.size()) / 500); // texels that two yarns share evenly
    CHECK(std::sqrt(squares / double(maps.gap.size())) < 0.005 * double(range.y - range.x));
}

TEST_CASE("plies lean to the right of the yarn for Z, to the left for S")
{
    for (const float twist : {25.0f, -25.0f}) {
        Fabric fabric = weave("satin 5");
        fabric.warp.ply_twist_deg = twist;
        const PackedFabric packed = baked(fabric);
        double sum = 0, count = 0;
        for (const glm::uvec2 words : packed.side[0].texels)
            if (const Texel texel = unpack_texel(words); !texel.gap && packed.type_of(texel.yarn) == 0) {
                sum += static_cast<double>(std::cos(texel.azimuth)) * (texel.azimuth < pi / 2 ? 1 : -1) *
                       (texel.azimuth < pi / 2 ? 1 : -1);
                count += 1;
            }
        // Ends run along y: a ply that rises to the right has an azimuth below 90 deg.
        CHECK((sum / count > 0) == (twist > 0));
        CHECK(std::abs(sum / count) > 0.1);
    }
}

TEST_CASE("the horizon of a wall is the angle under which it stands")
{
    const glm::ivec2 size(64, 32);
    std::vector<float> height(64 * 32, 0.0f);
    for (int y = 0; y < 32; ++y)
        for (int x = 40; x < 44; ++x) height[static_cast<std::size_t>(y * 64 + x)] = 0.2f;
    const HeightField field{size, {1, 0.5f}, &height};
    const glm::vec2 range_m(0, 0.2f);
    for (const int x : {4, 20, 36}) {
        const float distance = (40.5f - (static_cast<float>(x) + 0.5f)) / 64;
        CHECK(march_horizon(field, range_m, glm::vec2(x, 7) + 0.5f, 0) ==
              Approx(0.2f / std::hypot(0.2f, distance)).epsilon(1e-4));
        // 60 degrees off: twice as far
        CHECK(march_horizon(field, range_m, glm::vec2(x, 7) + 0.5f, pi / 3) ==
              Approx(0.2f / std::hypot(0.2f, 2 * distance)).epsilon(0.03));
    }
    // From the other side, around the seam
    CHECK(march_horizon(field, range_m, {4.5f, 3.5f}, pi) ==
          Approx(0.2f / std::hypot(0.2f, (4.5f + 64 - 43.5f) / 64)).epsilon(1e-4));
    CHECK(march_horizon(field, range_m, {41.5f, 3.5f}, 1.0f) == 0);
    // The fitted knots follow: knot 0 looks to +x, knot 4 to -x, knot 2 along the wall.
    const auto knots = horizon_knots(field);
    float s[8];
    unpack_knots(knots[static_cast<std::size_t>(3 * 32 + 15)], s); // block of texels 30, 31
    CHECK(s[0] == Approx(0.2f / std::hypot(0.2f, 9.5f / 64)).margin(0.03));
    CHECK(s[4] == Approx(0.2f / std::hypot(0.2f, (31 + 64 - 43.5f) / 64)).margin(0.03));
    CHECK(s[2] < 0.25f);
}

TEST_CASE("the sweep sees what the march sees")
{
    // Least squares keep the mean over the azimuths: that of the knots is that of the horizons they are fitted to. The
    // sweep takes the mean of two lines beside a receiver, the march the line through it: what differs is of the order
    // of one texel's share in a horizon.
    Fabric fabric = weave("twill 2/2");
    fabric.resolution = 96;
    const PackedFabric packed = baked(fabric);
    for (int side = 0; side < 2; ++side) {
        const std::vector<float> heights = heights_m(packed, side);
        const HeightField field{packed.size, packed.tile_m, &heights};
        const glm::vec2 range_m = height_range(field);
        double squares = 0, difference = 0;
        int count = 0;
        for (int Y = 0; Y < packed.size.y / 2; Y += 3)
            for (int X = 0; X < packed.size.x / 2; X += 3, ++count) {
                float s[8];
                unpack_knots(packed.side[side].horizons[static_cast<std::size_t>(Y * packed.size.x / 2 + X)], s);
                double knots = 0, marched = 0;
                for (const float knot : s) knots += static_cast<double>(knot) / 8;
                for (int j = 0; j < horizon_azimuths; ++j)
                    marched +=
                        static_cast<double>(march_horizon(field, range_m, {2 * X + 1, 2 * Y + 1},
                                                          2 * pi * (static_cast<float>(j) + 0.5f) / horizon_azimuths)) /
                        horizon_azimuths;
                squares += (knots - marched) * (knots - marched);
                difference += knots - marched;
            }
        CHECK(std::sqrt(squares / count) < 0.02);
        CHECK(std::abs(difference / count) < 0.005);
    }
}

TEST_CASE("horizons go round the repeat")
{
    // The same field, its repeat written once, and twice along x and three times along y: the lines close later and at
    // azimuths up to 0.3 degrees apart, which moves a knot by little; a line that ended at the tile's edge would miss
    // it by far.
    const glm::ivec2 size(48, 40);
    std::vector<float> once(static_cast<std::size_t>(size.x * size.y));
    for (int y = 0; y < size.y; ++y)
        for (int x = 0; x < size.x; ++x)
            once[static_cast<std::size_t>(y * size.x + x)] =
                0.1f * std::max(0.0f, std::sin(2 * pi * static_cast<float>(x) / 48) *
                                          std::sin(2 * pi * static_cast<float>(y + x) / 40));
    for (int y = 0; y < size.y; ++y) // a ridge along the seam
        for (int x = 0; x < size.x; ++x)
            once[static_cast<std::size_t>(y * size.x + x)] +=
                0.15f * std::exp(-static_cast<float>((x + 3) % size.x * ((x + 3) % size.x)) / 40);
    const glm::ivec2 more(2 * size.x, 3 * size.y);
    std::vector<float> often(static_cast<std::size_t>(more.x * more.y));
    for (int y = 0; y < more.y; ++y)
        for (int x = 0; x < more.x; ++x)
            often[static_cast<std::size_t>(y * more.x + x)] =
                once[static_cast<std::size_t>(y % size.y * size.x + x % size.x)];
    for (const int count : {8, 16}) {
        const auto a = horizon_knots({size, {1, 0.8f}, &once}, count);
        const auto b = horizon_knots({more, {2, 2.4f}, &often}, count);
        const std::size_t words = static_cast<std::size_t>(count / 8);
        REQUIRE(a.size() == words * static_cast<std::size_t>(size.x * size.y / 4));
        double squares = 0;
        for (int Y = 0; Y < size.y / 2; ++Y)
            for (int X = 0; X < size.x / 2; ++X)
                for (std::size_t part = 0; part < words; ++part) {
                    float s[8], t[8];
                    unpack_knots(a[static_cast<std::size_t>(Y * size.x / 2 + X) * words + part], s);
                    unpack_knots(b[static_cast<std::size_t>((Y + size.y) * more.x / 2 + X + size.x / 2) * words + part],
                                 t);
                    for (int k = 0; k < 8; ++k) squares += static_cast<double>((s[k] - t[k]) * (s[k] - t[k])) / 8;
                }
        CHECK(std::sqrt(squares / static_cast<double>(a.size())) < 0.012);
    }
}

TEST_CASE("an open plane hides nothing and receives the whole sky")
{
    const glm::ivec2 size(16, 16);
    const std::vector<float> height(256, 0.001f);
    const auto knots = horizon_knots({size, {1, 1}, &height});
    for (const glm::uvec2 words : knots) CHECK(words == glm::uvec2(0));
    for (const glm::uvec2 cap : fit_cap({size, {1, 1}, &height})) // math.md 8.5: V = 1 up to the soft rim
        for (const float z : {1.0f, 0.7f, 0.12f})
            CHECK(cloth::f32::cloth_cap_visibility(cap, {std::sqrt(1 - z * z), 0, z}) == 1);
    for (const glm::vec2 slope : {glm::vec2(0), glm::vec2(1, 0), glm::vec2(-2, 3)}) {
        const auto irradiance = cosine_irradiance(knots, std::vector<glm::vec2>(256, slope), size);
        const double nz = 1 / std::sqrt(1 + static_cast<double>(glm::dot(slope, slope)));
        CHECK(irradiance[37] == Approx((1 + nz) / 2).margin(0.012)); // 8 azimuths against the integral
    }
}

TEST_CASE("fitted visibility stays within the error of eight knots at half resolution")
{
    // math.md 8.4: deep plies, half resolution: .171 plain, .168 twill.
    for (const char* pattern : {"plain 1/1", "twill 2/2", "satin 5"})
        CHECK(measure_visibility(baked(weave(pattern)), 256, 512).rms < 0.185);
    CHECK(measure_visibility(baked(weave("plain 1/1", 1)), 256, 512).rms < 0.16);
}

TEST_CASE("derived diffuse terms never make energy")
{
    for (const float albedo : {0.0f, 0.3f, 0.8f, 1.0f})
        for (const float thickness : {0.02f, 0.3f, 1.0f, 2.0f, 5.0f, 20.0f}) {
            Fabric fabric = weave("plain 1/1");
            fabric.warp.albedo = glm::vec3(albedo);
            fabric.warp.thickness = thickness;
            const auto yarn = shade_yarns(fabric)[0];
            // first-collision escape + later ones + what passes: all of it at albedo 1 (math.md 9.2)
            const float once =
                (1 - std::exp(-thickness)) * (0.26f + 0.74f * std::exp(-1.23f * std::pow(thickness, 0.9f)));
            CHECK(albedo * once + yarn.diffuse_r.x + yarn.diffuse_t.x <= 1);
            CHECK(yarn.diffuse_r.x >= 0);
            CHECK(yarn.diffuse_t.x >= 0);
        }
    // Single scattering and light between the fibres added, at angles that no table has: the whitest yarns are limited.
    for (const float albedo : {0.9f, 1.0f})
        for (const float thickness : {0.05f, 0.5f, 2.0f, 8.0f})
            for (const float roughness : {0.02f, 0.3f, 1.0f}) {
                Fabric fabric = weave("plain 1/1");
                fabric.warp.albedo = glm::vec3(albedo);
                fabric.warp.thickness = thickness;
                fabric.warp.roughness = roughness;
                const auto yarn = shade_yarns(fabric)[0];
                for (const double angle : {12.0, 40.0, 70.0, 80.0, 87.0}) {
                    const double wide = double(roughness);
                    const glm::dvec3 slab =
                        slab_albedo(wide, wide, double(thickness), std::cos(glm::radians(angle)), 0.37);
                    CHECK(double(albedo) * (slab.x + slab.y) + slab.z + double(yarn.diffuse_r.x + yarn.diffuse_t.x) <=
                          1.002);
                }
            }
    Fabric fabric = weave("plain 1/1");
    fabric.warp.albedo = glm::vec3(0.8f);
    fabric.warp.thickness = 2;
    const auto yarn = shade_yarns(
        fabric)[0]; // T = 2: R_ms + T_ms = .574 at albedo 1, normal incidence; mean over the hemisphere is more
    CHECK(yarn.diffuse_r.x + yarn.diffuse_t.x == Approx(0.64 * 0.262 / (1 - 0.8 * 0.738) * 0.63).margin(0.03));
}

TEST_CASE("two yarns over each other are two layers that light goes to and fro between")
{
    Fabric fabric = weave("plain 1/1");
    fabric.warp.albedo = {0.95f, 0.7f, 0.4f}, fabric.warp.thickness = 0.8f;
    fabric.weft.albedo = {0.3f, 0.9f, 0.8f}, fabric.weft.thickness = 2.5f;
    const auto yarns = shade_yarns(fabric, {{0, 1}, {1, 0}});
    std::mt19937 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int c = 0; c < 3; ++c) {
        // A walk between the layers knows nothing of series.
        const double r[2] = {double(yarns[0].reflectance[c]), double(yarns[1].reflectance[c])};
        const double all[2] = {double(yarns[0].albedo[c]), double(yarns[1].albedo[c])};
        constexpr int photons = 400000;
        double back = 0, through = 0;
        for (int k = 0; k < photons; ++k)
            for (int layer = 0, way = 1; layer >= 0 && layer < 2; layer += way) {
                const double u = unit(random);
                if (u >= all[layer]) break;
                if (u < r[layer]) way = -way;
                if (layer == 0 && way < 0) back += 1.0 / photons;
                if (layer == 1 && way > 0) through += 1.0 / photons;
            }
        CHECK(double(yarns[2].reflectance[c]) == Approx(back).margin(4 * std::sqrt(back / photons)));
        CHECK(double(yarns[2].albedo[c]) == Approx(back + through).margin(4 * std::sqrt((back + through) / photons)));
        // As much comes through from either side.
        CHECK(double(yarns[3].albedo[c] - yarns[3].reflectance[c]) ==
              Approx(double(yarns[2].albedo[c] - yarns[2].reflectance[c])).epsilon(1e-4));
    }
    CHECK(yarns[2].beneath == fabric.weft.thickness);
    CHECK(yarns[2].albedo_r == yarns[0].albedo_r);
    // Under a yarn that lets nothing through lies nothing that shows.
    fabric.warp.thickness = 20, fabric.warp.albedo_transmission = fabric.warp.diffuse_transmission = glm::vec3(0);
    fabric.warp.diffuse = glm::vec3(0.3f);
    const auto opaque = shade_yarns(fabric, {{0, 1}});
    CHECK(opaque[2].diffuse_r.x == Approx(opaque[0].diffuse_r.x).margin(1e-6));
    CHECK(opaque[2].diffuse_t.x < 1e-6f);
    // The whitest yarns keep their energy at every angle.
    for (const float thickness : {0.05f, 0.5f, 2.0f, 8.0f})
        for (const float roughness : {0.02f, 0.3f, 1.0f}) {
            for (YarnSpec* yarn : {&fabric.warp, &fabric.weft}) {
                *yarn = YarnSpec{};
                yarn->albedo = glm::vec3(1), yarn->thickness = thickness, yarn->roughness = roughness;
            }
            const auto yarns_here = shade_yarns(fabric, {{0, 1}, {1, 0}});
            const auto& stack = yarns_here[2];
            CHECK(stack.albedo.x <= 1.0001f);
            for (const double angle : {12.0, 40.0, 70.0, 80.0, 87.0}) {
                const double wide = double(roughness);
                const glm::dvec3 slab = slab_albedo(wide, wide, double(thickness), std::cos(glm::radians(angle)), 0.37);
                // The fibres of the lower yarn cross those of the upper one, or run along them.
                for (const double across : {0.37, std::sqrt(1 - 0.37 * 0.37)}) {
                    const double lower =
                        slab_albedo(wide, wide, double(thickness), std::cos(glm::radians(angle)), across).y;
                    CHECK(double(stack.albedo_r.x) * slab.x + double(stack.albedo_t.x) * slab.y +
                              double(yarns_here[3].albedo_t.x) * lower + slab.z * slab.z +
                              double(stack.diffuse_r.x + stack.diffuse_t.x) <=
                          1.002);
                }
            }
        }
    // The ingredient by itself.
    const auto off = shade_yarns(fabric, {{0, 1}}, false);
    CHECK(off[2].diffuse_t == off[0].diffuse_t);
    CHECK(off[0].albedo == off[0].reflectance);
}

TEST_CASE("two yarns lie over each other where front and back show different ones")
{
    // Two straight tubes that cross, of 0.4 and 0.3 of the tile.
    PlyModel model = straight_tube(1, 0.2f, 1);
    PlyTube across = model.tubes[0];
    for (PlyPoint& point : across.points) point = {{point.centre_m.y, 0.5f, -0.35f}, 0.15f};
    across.thread = 1, across.yarn = 1;
    model.tubes.push_back(across);
    const FabricMaps maps = project_plies(model, {64, 64}, 4);
    std::size_t stacked = 0, wrong = 0;
    for (int y = 0; y < 64; ++y)
        for (int x = 0; x < 64; ++x) {
            const std::size_t i = std::size_t(y * 64 + x);
            const float from_first = std::abs((float(x) + 0.5f) / 64 - 0.5f),
                        from_second = std::abs((float(y) + 0.5f) / 64 - 0.5f);
            const bool edge = std::abs(from_first - 0.2f) < 1.0f / 64 || std::abs(from_second - 0.15f) < 1.0f / 64;
            stacked += maps.stacked[i];
            wrong += !edge && (maps.stacked[i] != 0) != (from_first < 0.2f && from_second < 0.15f);
        }
    CHECK(wrong == 0);
    CHECK(double(stacked) / 4096 == Approx(0.4 * 0.3).epsilon(0.1));
    // Plies of one yarn are one yarn.
    model.tubes[1].thread = 0;
    for (const std::uint8_t is : project_plies(model, {64, 64}, 4).stacked) REQUIRE(is == 0);

    const PackedFabric plain = baked(weave("plain 1/1", 1));
    CHECK(plain.stacks == std::vector<YarnStack>{{0, 1}, {1, 0}});
    CHECK(plain.yarns.size() == 4);
    CHECK(plain.type_of(1) == 1);
    CHECK(plain.type_of(3) == plain.stacks[1].upper);
    std::size_t both = 0, otherwise = 0;
    for (std::size_t i = 0; i < plain.side[0].texels.size(); ++i) {
        const Texel front = unpack_texel(plain.side[0].texels[i]), back = unpack_texel(plain.side[1].texels[i]);
        REQUIRE((front.yarn >= 2) == (back.yarn >= 2));
        both += front.yarn >= 2;
        otherwise += !front.gap && (front.yarn >= 2) != (plain.type_of(front.yarn) != plain.type_of(back.yarn));
    }
    // Here warp over warp is one yarn, warp over weft are two; texels at edges count by their samples.
    CHECK(double(otherwise) / double(plain.side[0].texels.size()) < 0.02);
    CHECK(double(both) / double(plain.side[0].texels.size()) > 0.6);
}

TEST_CASE("draft colours become yarn types, never more than the words can name")
{
    Fabric fabric = weave("plain 1/1");
    fabric.use_draft_colours = true;
    fabric.draft = repeated(fabric.draft, 300, 1);
    for (std::size_t e = 0; e < fabric.draft.ends.size(); ++e) {
        fabric.draft.colours.push_back(glm::vec3(static_cast<float>(e) / 600, static_cast<float>(e % 25) / 25, 0.5f));
        fabric.draft.ends[e].colour = static_cast<int>(e);
    }
    const YarnTypes types = yarn_types(fabric);
    CHECK(types.types.size() <= yarn_type_limit);
    CHECK(types.types.size() > 20);
    CHECK_FALSE(types.warning.empty());
    CHECK(types.types.back().warp == false);
    CHECK(types.end_type.size() == 600);
}

TEST_CASE("a bake is the same words whatever the thread count")
{
    Fabric fabric = weave("twill 2/2");
    fabric.visibility =
        GENERATE(VisibilityKind::horizon8, VisibilityKind::horizon16, VisibilityKind::cap, VisibilityKind::asg_lsq);
    if (fabric.visibility != VisibilityKind::horizon8) fabric.resolution = 96;
    const PackedFabric many = baked(fabric);
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    CHECK(same_words(many, baked(fabric)));
}

TEST_CASE("the cache gives back the bake, ignores shading, and survives damage")
{
    const CacheFolder cache;
    Fabric fabric = weave("plain 1/1");
    fabric.resolution = 64;
    BakeReport report;
    const PackedFabric first = bake_fabric(fabric, {}, &report);
    CHECK_FALSE(report.cached);
    CHECK(report.disk_bytes > 0);
    CHECK(same_words(first, bake_fabric(fabric, {}, &report)));
    CHECK(report.cached);

    fabric.warp.albedo = glm::vec3(0.1f, 0.2f, 0.3f);
    fabric.warp.roughness = 0.7f;
    fabric.weft.fibre_twist_deg = 9;
    fabric.weft.thickness = 1;
    const PackedFabric recoloured = bake_fabric(fabric, {}, &report);
    CHECK(report.cached);
    CHECK(recoloured.yarns[0].albedo_r.z == 0.3f);
    CHECK(recoloured.yarns[0].alpha_r == 0.7f);

    const std::string file = cache.only_file();
    for (const std::size_t at : {std::size_t(9), std::size_t(200), std::size_t(5000)}) { // header, counts, payload
        {
            std::fstream damage(file, std::ios::in | std::ios::out | std::ios::binary);
            damage.seekp(static_cast<std::streamoff>(at));
            damage.put('\x5a');
        }
        CHECK(same_words(first, bake_fabric(fabric, {}, &report)));
        CHECK_FALSE(report.cached);
        bake_fabric(fabric, {}, &report);
        CHECK(report.cached); // mended
    }
    std::filesystem::resize_file(file, 1000);
    CHECK(same_words(first, bake_fabric(fabric, {}, &report)));
    CHECK_FALSE(report.cached);

    for (const YarnParam& row : yarn_params) { // every geometric number asks for a bake, no other does
        Fabric changed = fabric;
        changed.warp.*row.member *= 0.93f;
        bake_fabric(changed, {}, &report);
        INFO(row.key);
        // A twist is rounded to whole steps of the plies, so a small change may leave the tubes as they are.
        if (std::string(row.key) != "ply_twist") CHECK(report.cached == !row.geometry);
    }
    fabric.warp.section = YarnSection::racetrack;
    bake_fabric(fabric, {}, &report);
    CHECK_FALSE(report.cached);
}

TEST_CASE("a damaged part of the cache is baked again by itself")
{
    const CacheFolder cache;
    Fabric fabric = weave("plain 1/1");
    fabric.resolution = 64;
    fabric.visibility = VisibilityKind::cap;
    BakeReport report;
    const PackedFabric first = bake_fabric(fabric, {}, &report);
    CHECK(report.baked.size() == 4);
    for (const auto& entry : std::filesystem::directory_iterator(cache.path)) {
        const bool maps = entry.path().extension() == ".maps";
        std::filesystem::resize_file(entry.path(), std::filesystem::file_size(entry.path()) / 2);
        CHECK(same_words(first, bake_fabric(fabric, {}, &report)));
        CHECK(report.baked.size() == (maps ? 4 : 1));
        bake_fabric(fabric, {}, &report);
        CHECK(report.cached);
    }
}

TEST_CASE("a cache that cannot be written is no error")
{
    ::setenv("SELVEDGE_CACHE", "/proc/nowhere", 1);
    Fabric fabric = weave("plain 1/1");
    fabric.resolution = 64;
    BakeReport report;
    CHECK(bake_fabric(fabric, {}, &report).side[0].texels.size() == 64 * 64);
    CHECK(report.disk_bytes == 0);
    ::unsetenv("SELVEDGE_CACHE");
}

TEST_CASE("a repeat that cannot be resolved is refused before anything large is made")
{
    Fabric fabric = weave("plain 1/1");
    fabric.draft = repeated(fabric.draft, 2500, 1);
    fabric.draft.ends[0].spacing_m = 0.001f;
    fabric.draft.ends[7].spacing_m = 0.002f; // no smaller repeat
    CHECK_THROWS_AS(plan_woven(fabric, 256), InputError);
}

TEST_CASE("pictures come back as they were written, and damaged ones are refused")
{
    const CacheFolder folder; // any folder
    std::filesystem::create_directories(folder.path);
    Image image(33, 21, {"R", "G", "B", "variance.R"});
    for (std::size_t i = 0; i < image.pixels.size(); ++i) image.pixels[i] = std::sin(static_cast<float>(i)) * 100 - 3;
    write_exr(folder.path + "/a.exr", image, {{"seed", "7"}});
    const Image again = read_image(folder.path + "/a.exr");
    CHECK(again.channels == image.channels);
    CHECK(again.pixels == image.pixels);
    CHECK(again.metadata.at("seed") == "7");
    Image grey(64, 64, {"R", "G", "B"});
    for (std::size_t i = 0; i < grey.pixels.size(); ++i) grey.pixels[i] = static_cast<float>(i % 256) / 255;
    grey.pixels[0] = std::nanf("");
    write_png(folder.path + "/a.png", grey);
    const Image decoded = read_image(folder.path + "/a.png");
    CHECK(decoded.pixels[0] == 0);
    CHECK(decoded.pixels[188] == Approx(0.50289).epsilon(1e-3)); // 188/255, sRGB to linear
    for (const char* name : {"/a.exr", "/a.png"}) {
        INFO(name);
        const auto size = std::filesystem::file_size(folder.path + name);
        for (const double share : {0.9, 0.5, 0.05}) {
            std::filesystem::copy_file(folder.path + name, folder.path + "/cut" + std::string(name + 2),
                                       std::filesystem::copy_options::overwrite_existing);
            std::filesystem::resize_file(folder.path + "/cut" + std::string(name + 2),
                                         static_cast<std::uintmax_t>(static_cast<double>(size) * share));
            CHECK_THROWS_AS(read_image(folder.path + "/cut" + std::string(name + 2)), InputError);
        }
    }
    CHECK_THROWS_AS(read_image(folder.path), InputError);
    CHECK_THROWS_AS(read_image(folder.path + "/none.exr"), InputError);
    CHECK_THROWS_AS(write_exr(folder.path + "/no/folder.exr", image), InputError);
    std::size_t files = 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder.path)) ++files;
    CHECK(files == 4); // nothing half-written is left behind
}
