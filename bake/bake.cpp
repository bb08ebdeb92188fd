// bake/bake.cpp: the whole way from a fabric to packed words, with the cache; yarn shading; accuracy of the visibility.
#include "bake.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <map>
#include <utility>

#include <tbb/parallel_for.h>

#include "cache.hpp"
#include "energy.hpp"
#include "error.hpp"
#include "knit_yarns.hpp"
#include "maps.hpp"
#include "ply.hpp"
#include "visibility.hpp"

namespace selvedge
{

namespace
{

constexpr float unscattered_limit =
    1e-3f; // a yarn that lets less than this through at normal incidence is taken for opaque

class Stopwatch
{
  public:
    double lap() // seconds since the last one
    {
        const auto now = std::chrono::steady_clock::now();
        const double spent = std::chrono::duration<double>(now - last).count();
        last = now;
        return spent;
    }

  private:
    std::chrono::steady_clock::time_point last = std::chrono::steady_clock::now();
};

// The stacks that occur, the most frequent first, as many as there are numbers for beside the yarn types.
std::vector<YarnStack> find_stacks(const FabricMaps& maps, std::size_t types)
{
    std::map<std::pair<std::uint8_t, std::uint8_t>, std::size_t> texels;
    for (std::size_t i = 0; i < maps.stacked.size(); ++i)
        for (int s = 0; s < 2 && maps.stacked[i]; ++s) ++texels[{maps.side[s].yarn[i], maps.side[1 - s].yarn[i]}];
    std::vector<std::pair<std::size_t, YarnStack>> order;
    for (const auto& [pair, count] : texels) order.push_back({count, {pair.first, pair.second}});
    std::stable_sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
    std::vector<YarnStack> stacks;
    for (const auto& [count, stack] : order)
        if (types + stacks.size() < std::size_t(yarn_type_limit)) stacks.push_back(stack);
    return stacks;
}

// Row of PackedFabric::yarns. A stack without a number is the most frequent one with the same upper yarn, or that
// alone.
int yarn_of(const FabricMaps& maps, int s, std::size_t i, const std::vector<YarnStack>& stacks, std::size_t types)
{
    const YarnStack here{maps.side[s].yarn[i], maps.side[1 - s].yarn[i]};
    if (!maps.stacked[i]) return here.upper;
    auto at = std::find(stacks.begin(), stacks.end(), here);
    if (at == stacks.end())
        at = std::find_if(stacks.begin(), stacks.end(),
                          [&](const YarnStack& stack) { return stack.upper == here.upper; });
    return at == stacks.end() ? here.upper : static_cast<int>(types + std::size_t(at - stacks.begin()));
}

void pack_side(const FabricMaps& maps, int s, const std::vector<float>& irradiance,
               const std::vector<YarnStack>& stacks, std::size_t types, PackedSide& out)
{
    const SideMaps& side = maps.side[s];
    out.texels.resize(side.slope.size());
    for (std::size_t i = 0; i < side.slope.size(); ++i) {
        Texel texel;
        texel.gap = maps.gap[i] != 0;
        texel.slope = texel.gap ? glm::vec2(0) : side.slope[i];
        texel.azimuth = side.azimuth[i];
        texel.yarn = yarn_of(maps, s, i, stacks, types);
        texel.irradiance = irradiance[i];
        out.texels[i] = pack_texel(texel);
    }
}

void count_cover(const FabricMaps& maps, const YarnTypes& types, PackedFabric& packed)
{
    std::size_t warp = 0, gap = 0;
    for (std::size_t i = 0; i < maps.gap.size(); ++i)
        if (maps.gap[i])
            ++gap;
        else if (types.types[maps.side[0].yarn[i]].warp)
            ++warp;
    const float total = static_cast<float>(maps.gap.size());
    packed.gap_cover = static_cast<float>(gap) / total;
    packed.warp_cover = static_cast<float>(warp) / total;
    packed.weft_cover = static_cast<float>(maps.gap.size() - gap - warp) / total;
    packed.has_gaps = gap > 0;
}

// What follows from shading parameters, and costs little: the twist noise, light between fibres.
void finish(const Fabric& fabric, PackedFabric& packed)
{
    const glm::vec2 cells = packed.tile_m / fabric.irregularity_length_m;
    packed.noise_cells = glm::max(glm::ivec2(glm::round(cells)), glm::ivec2(1));
    packed.noise_amplitude = glm::radians(fabric.irregularity_deg);
    for (const cloth::f32::ClothYarn& yarn : packed.yarns)
        packed.lets_light_between_fibres =
            packed.lets_light_between_fibres || std::exp(-yarn.thickness) > unscattered_limit;
}

// Cloth of single-ply yarns may be its own mirror image in the mid-plane, moved by some threads: plain weaves, even
// twills and baskets. (Plies wind to one hand and start anywhere.) Texels from a point of the back to its like on the
// front, even ones; absent where there are none.
std::optional<glm::ivec2> mirrored_shift(const WovenPlan& plan)
{
    const Draft& repeat = plan.repeat;
    const std::size_t ends = repeat.ends.size(), picks = repeat.picks.size();
    if (plan.warp_plies > 1 || plan.weft_plies > 1) return std::nullopt;
    // Moves along one system that leave its yarns as they are, as (threads, texels).
    using Move = std::pair<std::size_t, int>;
    const auto moves = [](const std::vector<int>& type, const std::vector<float>& spacing_m,
                          const std::vector<float>& width_m, float tile_m, int texels) {
        std::vector<Move> list;
        const std::size_t n = type.size();
        double at = 0;
        for (std::size_t by = 0; by < n; at += double(spacing_m[by]), ++by) {
            const double half = at / double(tile_m) * texels / 2;
            bool same = std::abs(half - std::round(half)) < 1e-3;
            for (std::size_t k = 0; k < n && same; ++k) {
                const std::size_t there = (k + by) % n;
                same = type[k] == type[there] && spacing_m[k] == spacing_m[there] && width_m[k] == width_m[there];
            }
            if (same) list.emplace_back(by, 2 * static_cast<int>(std::lround(half)));
        }
        return list;
    };
    const std::vector<Move> along_x =
        moves(plan.end_type, plan.end_spacing_m, plan.end_width_m, plan.tile_m.x, plan.size.x);
    for (const Move& y : moves(plan.pick_type, plan.pick_spacing_m, plan.pick_width_m, plan.tile_m.y, plan.size.y))
        for (const Move& x : along_x) {
            bool mirrored = true;
            for (std::size_t p = 0; p < picks && mirrored; ++p)
                for (std::size_t e = 0; e < ends && mirrored; ++e)
                    mirrored =
                        repeat.warp_on_top(p, e) != repeat.warp_on_top((p + y.first) % picks, (e + x.first) % ends);
            if (mirrored) return glm::ivec2(x.second, y.second);
        }
    return std::nullopt;
}

// Rows of `per` items a cell, cells moved around the tile: out(x, y) = in(x + shift.x, y + shift.y).
template <class T> std::vector<T> moved(const std::vector<T>& in, glm::ivec2 cells, glm::ivec2 shift, int per)
{
    std::vector<T> out(in.size());
    for (int y = 0; y < cells.y; ++y)
        for (int x = 0; x < cells.x; ++x) {
            const int from = ((y + shift.y) % cells.y * cells.x + (x + shift.x) % cells.x) * per;
            std::copy_n(in.begin() + from, per, out.begin() + (y * cells.x + x) * per);
        }
    return out;
}

// What the rest of the bake asks of a pattern, woven or knit.
struct Geometry {
    glm::ivec2 size{0}; // texels
    glm::vec2 tile_m{0};
    std::optional<glm::ivec2> back_shift; // where the back is the front, moved: by this many texels
    std::vector<std::string> warnings;
    std::function<std::string()> hash;
    std::function<PlyModel(std::vector<std::string>& warnings)> plies;
};

Geometry woven_geometry(const Fabric& fabric, int resolution)
{
    const WovenPlan plan = plan_woven(fabric, resolution);
    return {plan.size,
            plan.tile_m,
            mirrored_shift(plan),
            plan.warnings,
            [&fabric, plan] { return geometry_hash(fabric, plan); },
            [&fabric, plan](auto&) { return wind_plies(plan.tile_m, weave_yarns(fabric, plan)); }};
}

Geometry knit_geometry(const Fabric& fabric, int resolution)
{
    const KnitPlan plan = plan_knit(fabric, resolution);
    return {plan.size,
            plan.tile_m,
            std::nullopt,
            plan.warnings,
            [&fabric, plan] { return geometry_hash(fabric, plan); },
            [&fabric, plan](auto& warnings) {
                PlyModel model = wind_plies(plan.tile_m, knit_yarns(fabric, plan, warnings));
                model.wall_share = 1, model.gap_steepness = 3; // loops lie high above each other
                return model;
            }};
}

Geometry geometry_of(const Fabric& fabric, int resolution)
{
    return fabric.knit ? knit_geometry(fabric, resolution) : woven_geometry(fabric, resolution);
}

} // namespace

std::vector<cloth::f32::ClothYarn> shade_yarns(const Fabric& fabric, const std::vector<YarnStack>& stacks, bool stacked)
{
    std::vector<cloth::f32::ClothYarn> out;
    const SlabTable warp = slab_table(fabric.warp), weft = slab_table(fabric.weft);
    const std::vector<YarnTypes::Type> types = yarn_types(fabric).types;
    const auto slab = [&](std::size_t type) -> const SlabTable& { return types[type].warp ? warp : weft; };
    for (std::size_t k = 0; k < types.size(); ++k)
        out.push_back(shade_yarn(types[k].warp ? fabric.warp : fabric.weft, types[k].tint, slab(k)));
    for (const auto [upper, lower] : stacks)
        out.push_back(stacked ? stack_yarns(out.at(upper), slab(upper), out.at(lower), slab(lower)) : out.at(upper));
    for (cloth::f32::ClothYarn& yarn : out)
        if (!stacked) {
            yarn.transmittance = glm::vec3(0);
            yarn.albedo = yarn.reflectance;
        }
    return out;
}

PlyModel ply_model(const Fabric& fabric)
{
    std::vector<std::string> warnings; // the bake has told them
    return geometry_of(fabric, fabric.resolution).plies(warnings);
}

namespace
{

// Tubes -> maps -> horizons -> words; the horizons are always baked, for the cosine irradiance is made of them.
void bake_maps(const Geometry& geometry, const YarnTypes& types, PackedFabric& packed,
               std::vector<std::string>& warnings, BakeReport& spent)
{
    Stopwatch stage;
    packed.tile_m = geometry.tile_m;
    const PlyModel model = geometry.plies(warnings);
    spent.pattern_seconds = stage.lap();
    const FabricMaps maps = project_plies(model, packed.size, samples_for(packed.size));
    count_cover(maps, types, packed);
    packed.stacks = find_stacks(maps, types.types.size());
    const int sides = packed.back_shift ? 1 : 2;
    for (int s = 0; s < sides; ++s) pack_heights(maps.side[s].height_m, packed.side[s]);
    spent.maps_seconds = stage.lap();
    for (int s = 0; s < sides; ++s) {
        PackedSide& side = packed.side[s];
        const std::vector<float> heights = heights_m(packed, s); // as the cache has them
        side.horizons = horizon_knots({packed.size, packed.tile_m, &heights});
        std::vector<glm::vec2> shown = maps.side[s].slope; // as stored: gaps are flat
        for (std::size_t i = 0; i < shown.size(); ++i)
            if (maps.gap[i]) shown[i] = glm::vec2(0);
        const std::vector<float> irradiance = cosine_irradiance(side.horizons, shown, packed.size);
        spent.visibility_seconds += stage.lap();
        pack_side(maps, s, irradiance, packed.stacks, types.types.size(), side);
        spent.normals_seconds += stage.lap();
    }
    for (int s = 0; s < 2; ++s)
        for (const glm::vec2 slope : slope_mips(maps.side[s].slope, packed.size))
            packed.side[s].slope_mips.push_back(pack_slope(slope));
    spent.normals_seconds += stage.lap();
    spent.baked = {"pattern", "maps", "visibility", "normals"};
}

// What a kind other than horizon8 looks at.
void bake_visibility(PackedFabric& packed, BakeReport& spent)
{
    Stopwatch stage;
    for (int s = 0; s < (packed.back_shift ? 1 : 2); ++s) {
        const std::vector<float> heights = heights_m(packed, s);
        const HeightField field{packed.size, packed.tile_m, &heights};
        if (packed.visibility == VisibilityKind::horizon16)
            packed.side[s].words = horizon_knots(field, 16);
        else if (packed.visibility == VisibilityKind::cap)
            packed.side[s].words = fit_cap(field);
        else
            packed.side[s].asg = fit_asg(field, packed.visibility == VisibilityKind::asg_lsq);
    }
    spent.visibility_seconds += stage.lap();
    if (spent.baked.empty()) spent.baked = {"visibility"};
}

// The back out of the front, where it is that. Its slope mips are its own: large cells do not move by whole cells.
void mirror_front(PackedFabric& packed)
{
    if (!packed.back_shift) return;
    const glm::ivec2 shift = *packed.back_shift;
    const PackedSide& front = packed.side[0];
    PackedSide& back = packed.side[1];
    const glm::ivec2 half = packed.size / 2;
    back.texels = moved(front.texels, packed.size, shift, 1);
    back.horizons = moved(front.horizons, half, shift / 2, 1);
    back.height_range_m = front.height_range_m;
    back.heights = moved(front.heights, packed.size, shift, 1);
    const bool cap = packed.visibility == VisibilityKind::cap;
    if (!front.words.empty())
        back.words = moved(front.words, cap ? packed.size : half, cap ? shift : shift / 2, cap ? 1 : 2);
    if (!front.asg.empty()) back.asg = moved(front.asg, packed.size, shift, 2);
}

} // namespace

PackedFabric bake_fabric(const Fabric& fabric, const BakeOptions& options, BakeReport* report)
{
    Stopwatch total;
    BakeReport spent;
    const VisibilityKind kind = options.visibility.value_or(fabric.visibility);
    const int resolution = options.resolution > 0 ? options.resolution : fabric.resolution;
    const Geometry geometry = geometry_of(fabric, resolution);
    PackedFabric packed;
    packed.name = fabric.name;
    packed.size = geometry.size;
    packed.visibility = kind;
    packed.back_shift = geometry.back_shift;
    packed.warnings = fabric.warnings;
    packed.warnings.insert(packed.warnings.end(), geometry.warnings.begin(), geometry.warnings.end());
    const YarnTypes types = yarn_types(fabric);
    for (const YarnTypes::Type& type : types.types) packed.yarn_names.push_back(type.name);
    const std::string hash = options.use_cache ? geometry.hash() : "";
    const auto part = [&](CachePart which, const auto& bake) {
        std::vector<std::string> warnings;
        if (!options.use_cache || options.force || !read_cache(which, hash, packed, warnings, spent.disk_bytes)) {
            bake(warnings);
            if (options.use_cache) spent.disk_bytes += write_cache(which, hash, packed, warnings);
        }
        packed.warnings.insert(packed.warnings.end(), warnings.begin(), warnings.end());
    };
    part(CachePart::maps, [&](auto& warnings) { bake_maps(geometry, types, packed, warnings, spent); });
    if (kind != VisibilityKind::horizon8 && kind != VisibilityKind::exact)
        part(CachePart::visibility, [&](auto&) { bake_visibility(packed, spent); });
    mirror_front(packed);
    packed.yarns = shade_yarns(fabric, packed.stacks, options.stacked);
    for (const auto& yarn : packed.yarns)
        packed.transmits = packed.transmits || glm::any(glm::greaterThan(yarn.albedo_t + yarn.diffuse_t, glm::vec3(0)));
    spent.cached = spent.baked.empty();
    finish(fabric, packed);
    spent.memory_bytes = packed.resident_bytes();
    spent.total_seconds = total.lap();
    if (report) *report = spent;
    return packed;
}

VisibilityError measure_visibility(const PackedFabric& fabric, int directions, int texels)
{
    VisibilityError error;
    error.directions = directions;
    error.texels = texels;
    const glm::ivec2 size = fabric.size;
    const cloth::f32::ClothMaps maps = maps_of(fabric);
    cloth::f32::ClothSettings settings = full_model;
    settings.visibility = visibility_lookup(fabric.visibility);
    std::vector<double> sums(static_cast<std::size_t>(texels), 0.0);
    for (int side = 0; side < 2; ++side) {
        const std::vector<float> heights = heights_m(fabric, side);
        const HeightField field{size, fabric.tile_m, &heights};
        const glm::vec2 range_m = height_range(field);
        tbb::parallel_for(0, texels, [&](int t) {
            // Texels and directions on golden-ratio lattices: even cover, no seed.
            const double u = (t + 0.5) / texels, v = std::fmod(0.6180339887498949 * t, 1.0);
            const int x = static_cast<int>(u * size.x), y = static_cast<int>(v * size.y);
            double sum = 0;
            for (int d = 0; d < directions; ++d) {
                const float z = (static_cast<float>(d) + 0.5f) / static_cast<float>(directions),
                            r = std::sqrt(1 - z * z);
                const float azimuth = static_cast<float>(std::fmod(2.399963229728653 * d, 6.283185307179586));
                const float s = march_horizon(field, range_m, glm::vec2(x, y) + 0.5f, azimuth);
                const float exact = z > s ? 1.0f : 0.0f;
                const glm::vec3 direction(r * std::cos(azimuth), r * std::sin(azimuth), z);
                // The mean over the texel's sixteen spots: what many samples of it come to.
                float got = 0;
                for (int spot = 0; spot < 16; ++spot)
                    got += cloth::f32::cloth_visibility_at(maps, side, {4 * x + spot % 4, 4 * y + spot / 4}, direction,
                                                           settings) /
                           16;
                sum += static_cast<double>((got - exact) * (got - exact));
            }
            sums[static_cast<std::size_t>(t)] += sum;
        });
    }
    double sum = 0;
    for (const double s : sums) sum += s;
    error.rms = std::sqrt(sum / (2.0 * texels * directions));
    return error;
}

} // namespace selvedge
