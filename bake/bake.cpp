// bake/bake.cpp: the whole way from a fabric to packed words, with the cache; yarn shading; accuracy of the visibility.
#include "bake.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>

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

void pack_side(const FabricMaps& maps, int s, const std::vector<float>& irradiance, PackedSide& out)
{
    const SideMaps& side = maps.side[s];
    out.texels.resize(side.slope.size());
    for (std::size_t i = 0; i < side.slope.size(); ++i) {
        Texel texel;
        texel.gap = maps.gap[i] != 0;
        texel.slope = texel.gap ? glm::vec2(0) : side.slope[i];
        texel.azimuth = side.azimuth[i];
        texel.yarn = side.yarn[i];
        texel.irradiance = irradiance[i];
        out.texels[i] = pack_texel(texel);
    }
    out.heights_m = side.height_m;
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
    const auto [low, high] = std::minmax_element(maps.side[0].height_m.begin(), maps.side[0].height_m.end());
    packed.height_range_m = {*low, *high};
}

// What follows from cached words and from shading parameters, and costs little: heights as the shader wants them, the
// twist noise, and the paper's visibility where it is asked for.
void finish(const Fabric& fabric, VisibilityKind kind, PackedFabric& packed)
{
    for (PackedSide& side : packed.side) {
        const HeightField field{packed.size, packed.tile_m, &side.heights_m};
        side.height_range_m = height_range(field);
        const float low = side.height_range_m.x, range = std::max(side.height_range_m.y - low, 1e-9f);
        side.height_range_m.y = low + range;
        side.heights.resize(side.heights_m.size());
        for (std::size_t i = 0; i < side.heights.size(); ++i)
            side.heights[i] = static_cast<std::uint16_t>(
                std::lround(std::clamp((side.heights_m[i] - low) / range, 0.0f, 1.0f) * 65535.0f));
        if (kind == VisibilityKind::asg || kind == VisibilityKind::asg_lsq)
            side.asg = fit_asg(field, kind == VisibilityKind::asg_lsq);
    }
    const glm::vec2 cells = packed.tile_m / fabric.irregularity_length_m;
    packed.noise_cells = glm::max(glm::ivec2(glm::round(cells)), glm::ivec2(1));
    packed.noise_amplitude = glm::radians(fabric.irregularity_deg);
    for (const cloth::f32::ClothYarn& yarn : packed.yarns)
        packed.lets_light_between_fibres =
            packed.lets_light_between_fibres || std::exp(-yarn.thickness) > unscattered_limit;
}

// What the rest of the bake asks of a pattern, woven or knit.
struct Geometry {
    glm::ivec2 size{0}; // texels
    glm::vec2 tile_m{0};
    std::vector<std::string> warnings;
    std::function<std::string(VisibilityKind)> hash;
    std::function<PlyModel(std::vector<std::string>& warnings)> plies;
};

Geometry woven_geometry(const Fabric& fabric, int resolution)
{
    const WovenPlan plan = plan_woven(fabric, resolution);
    return {plan.size, plan.tile_m, plan.warnings,
            [&fabric, plan](VisibilityKind kind) { return geometry_hash(fabric, plan, kind); },
            [&fabric, plan](auto&) { return wind_plies(plan.tile_m, weave_yarns(fabric, plan)); }};
}

Geometry knit_geometry(const Fabric& fabric, int resolution)
{
    const KnitPlan plan = plan_knit(fabric, resolution);
    return {plan.size, plan.tile_m, plan.warnings,
            [&fabric, plan](VisibilityKind kind) { return geometry_hash(fabric, plan, kind); },
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

std::vector<cloth::f32::ClothYarn> shade_yarns(const Fabric& fabric)
{
    std::vector<cloth::f32::ClothYarn> out;
    const SlabTable warp = slab_table(fabric.warp), weft = slab_table(fabric.weft);
    for (const YarnTypes::Type& type : yarn_types(fabric).types)
        out.push_back(shade_yarn(type.warp ? fabric.warp : fabric.weft, type.tint, type.warp ? warp : weft));
    return out;
}

PlyModel ply_model(const Fabric& fabric)
{
    std::vector<std::string> warnings; // the bake has told them
    return geometry_of(fabric, fabric.resolution).plies(warnings);
}

PackedFabric bake_fabric(const Fabric& fabric, const BakeOptions& options, BakeReport* report)
{
    Stopwatch total, stage;
    BakeReport spent;
    const VisibilityKind kind = options.visibility.value_or(fabric.visibility);
    if (kind == VisibilityKind::horizon16 || kind == VisibilityKind::cap)
        throw UsageError("visibility %s is not available in this version, expected horizon8, asg, asg-lsq or exact",
                         visibility_name(kind));

    const int resolution = options.resolution > 0 ? options.resolution : fabric.resolution;
    const Geometry geometry = geometry_of(fabric, resolution);
    const glm::ivec2 size = geometry.size;
    PackedFabric packed;
    packed.name = fabric.name;
    packed.size = size;
    packed.visibility = kind;
    packed.warnings = fabric.warnings;
    packed.warnings.insert(packed.warnings.end(), geometry.warnings.begin(), geometry.warnings.end());
    const YarnTypes types = yarn_types(fabric);
    for (const YarnTypes::Type& type : types.types) packed.yarn_names.push_back(type.name);
    packed.yarns = shade_yarns(fabric);
    for (const auto& yarn : packed.yarns)
        packed.transmits = packed.transmits || glm::any(glm::greaterThan(yarn.albedo_t + yarn.diffuse_t, glm::vec3(0)));

    const std::string hash = options.use_cache ? geometry.hash(kind) : "";
    spent.cached = options.use_cache && !options.force && read_cache(hash, packed, &spent.disk_bytes);
    if (!spent.cached) {
        packed.tile_m = geometry.tile_m;
        stage.lap();
        const PlyModel model = geometry.plies(packed.warnings);
        spent.pattern_seconds = stage.lap();
        const FabricMaps maps = project_plies(model, size, samples_for(size));
        count_cover(maps, types, packed);
        spent.maps_seconds = stage.lap();
        for (int s = 0; s < 2; ++s) {
            PackedSide& side = packed.side[s];
            side.horizons = horizon_knots({size, geometry.tile_m, &maps.side[s].height_m});
            std::vector<glm::vec2> shown = maps.side[s].slope; // as stored: gaps are flat
            for (std::size_t i = 0; i < shown.size(); ++i)
                if (maps.gap[i]) shown[i] = glm::vec2(0);
            const std::vector<float> irradiance = cosine_irradiance(side.horizons, shown, size);
            spent.visibility_seconds += stage.lap();
            pack_side(maps, s, irradiance, side);
            for (const glm::vec2 slope : slope_mips(maps.side[s].slope, size))
                side.slope_mips.push_back(pack_slope(slope));
            spent.normals_seconds += stage.lap();
        }
        if (options.use_cache) spent.disk_bytes = write_cache(hash, packed);
    }
    finish(fabric, kind, packed);
    spent.visibility_seconds += stage.lap();
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
    if (fabric.visibility == VisibilityKind::exact) return error; // it is its own yardstick

    const glm::ivec2 size = fabric.size;
    const cloth::f32::ClothMaps maps = maps_of(fabric);
    cloth::f32::ClothSettings settings = full_model;
    if (fabric.visibility != VisibilityKind::horizon8) settings.visibility = cloth::f32::cloth_visibility_asg;
    std::vector<double> sums(static_cast<std::size_t>(texels), 0.0);
    for (int side = 0; side < 2; ++side) {
        const HeightField field{size, fabric.tile_m, &fabric.side[side].heights_m};
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
                const float got = cloth::f32::cloth_visibility_at(maps, side, {x, y}, direction, settings);
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
