// bake/bake.hpp: fabric in, packed fabric out, through the cache. Renderers and selvedge-bake include it.
#pragma once

#include <string>
#include <vector>

#include "fabric.hpp"
#include "pack.hpp"
#include "ply.hpp"

namespace selvedge
{

struct BakeOptions {
    int resolution = 0;                       // 0: the fabric's own
    std::optional<VisibilityKind> visibility; // absent: the fabric's own
    bool stacked = true;                      // light that has crossed one yarn meets the next (ModelSpec::stacked)
    bool use_cache = true; // read and write $SELVEDGE_CACHE, $XDG_CACHE_HOME/selvedge or ~/.cache/selvedge
    bool force = false;    // bake even when cached (and write the cache again)
};

struct BakeReport {
    double pattern_seconds = 0, maps_seconds = 0, visibility_seconds = 0, normals_seconds = 0, total_seconds = 0;
    std::size_t memory_bytes = 0;   // PackedFabric::resident_bytes
    std::size_t disk_bytes = 0;     // of the cache file; 0 without cache
    bool cached = false;            // nothing was baked
    std::vector<std::string> baked; // the stages that were: of "pattern", "maps", "visibility", "normals"
};

// Pattern -> plies -> maps -> horizons -> packed words. Pure but for the cache; uses all cores (TBB).
// Only what is not in the cache is baked: nothing for a new albedo, roughness or fibre twist, the visibility alone for
// a new kind of it.
//   throws  InputError: a repeat too large to resolve
PackedFabric bake_fabric(const Fabric& fabric, const BakeOptions& options = {}, BakeReport* report = nullptr);

// The tubes that the fabric's maps are projections of, at the resolution that its bake takes.
//   throws  InputError: a repeat too large to resolve
PlyModel ply_model(const Fabric& fabric);

// PackedFabric::yarns of a fabric; costs microseconds: for live edits of albedo, roughness, thickness, fibre twist.
//   stacks   of the bake
//   stacked  false: a stack is its upper yarn alone
std::vector<cloth::f32::ClothYarn> shade_yarns(const Fabric& fabric, const std::vector<YarnStack>& stacks = {},
                                               bool stacked = true);

// Accuracy of the packed visibility against exact horizons of the packed heights, both sides (math.md 8.4).
struct VisibilityError {
    double rms = 0;
    int directions = 0; // uniform in solid angle over the hemisphere
    int texels = 0;     // per side
};
VisibilityError measure_visibility(const PackedFabric& fabric, int directions = 256, int texels = 1024);

} // namespace selvedge
