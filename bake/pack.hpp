// bake/pack.hpp: the baked fabric as both renderers read it, word for word. Renderers include it; it includes glsl/
// only.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "cloth_bsdf.hpp"

namespace selvedge
{

inline constexpr float slope_limit = 4.0f;  // slopes are clamped to [-4, 4] (math.md hazard 2)
inline constexpr int yarn_type_limit = 128; // 7 bits in texels.y

// One side of the cloth; the back is in the mirrored frame: x, y unchanged, z negated.
struct PackedSide {
    std::vector<glm::uvec2> texels; // w*h, row y = 0 at v = 0. Words as pack_texel writes them
    std::vector<glm::uvec2>
        horizons; // (w/2)*(h/2): 8 unorm8 knots of sin(horizon), knot k at azimuth k*45 deg in byte k
    std::vector<glm::uint>
        slope_mips; // levels 1, 2, ... 1x1 concatenated, each max(1, w>>L) x max(1, h>>L): 2 x snorm16
    std::vector<std::uint16_t> heights; // w*h, unorm16 of height_range_m
    glm::vec2 height_range_m{0};        // lowest and highest of this side [m above the mid-plane in its frame]
    // Beside the horizons where the visibility is of another kind. horizon16: (w/2)*(h/2)*2, knot k at azimuth k*22.5
    // deg; cap: w*h, as pack_cap writes them
    std::vector<glm::uvec2> words;
    std::vector<glm::vec4> asg; // 2*w*h where the visibility is asg or asg-lsq: (mu, gamma), (sigma_x, sigma_y, C, 0)
};

enum class VisibilityKind { horizon8, horizon16, cap, asg, asg_lsq, exact };

// Yarn types of two yarns that lie over each other, seen from the side of the upper one.
struct YarnStack {
    std::uint8_t upper, lower;
    bool operator==(const YarnStack&) const = default;
};

struct PackedFabric {
    std::string name;
    glm::ivec2 size{0};                  // texels (w, h), both even
    glm::vec2 tile_m{0};                 // size of the repeat [m]
    PackedSide side[2];                  // [0] front, [1] back
    std::vector<std::string> yarn_names; // "warp", "weft #2f4f9a": one for each yarn type
    std::vector<YarnStack> stacks;       // two yarns over each other, those that occur
    // What texels name: the yarn types, then the stacks as the one yarn that each is to the eye; 1 to 128.
    std::vector<cloth::f32::ClothYarn> yarns;
    VisibilityKind visibility = VisibilityKind::horizon8;
    // Where the cloth is its own mirror image: texel (x, y) of the back is (x, y) + back_shift of the front. Such a
    // back is not baked, and the cache does not hold it.
    std::optional<glm::ivec2> back_shift;
    bool has_gaps = false;                  // any gap texel
    bool lets_light_between_fibres = false; // a yarn thin enough to show: see unscattered_limit
    glm::ivec2 noise_cells{1};              // of the twist noise in one repeat
    float noise_amplitude = 0;              // its mean absolute value [rad]
    bool transmits = false; // any yarn that lets light through (transmission lobes or diffuse transmission not 0)
    float warp_cover = 0, weft_cover = 0, gap_cover = 0; // shares of the front side's texels, sum 1
    std::vector<std::string> warnings;

    // What a renderer keeps on the device for the model "ours" with this visibility: texels, heights, and what the kind
    // looks at. The slope mips take the heights' place where the weight is `mips`.
    std::size_t resident_bytes() const;
    // The yarn type that a texel shows: itself, or the upper one of the stack.
    int type_of(int yarn) const;
    double visibility_bytes_per_texel() const; // and side
};

// The words that the look-up of a fabric's visibility reads: horizons or what takes their place; none for asg and
// exact.
const std::vector<glm::uvec2>& visibility_words(const PackedFabric& fabric, int side);
// cloth_visibility_* of a kind.
int visibility_lookup(VisibilityKind kind);

// Height of texel i, and of all of a side, as the 16 bits say them [m]: 0 in gaps to half a step.
float height_m(const PackedSide& side, std::size_t i);
std::vector<float> heights_m(const PackedFabric& fabric, int side);
// The inverse: 16 bits and the range.
void pack_heights(const std::vector<float>& heights, PackedSide& side);

// The fabric as the shared functions read it: pointers into `fabric`, which has to outlive them.
cloth::f32::ClothMaps maps_of(const PackedFabric& fabric);

// What one texel holds, unpacked.
struct Texel {
    glm::vec2 slope{0}; // (dh/dx, dh/dy)
    float azimuth = 0;  // of the ply's tangent [rad], [0, pi)
    int yarn = 0;       // row of PackedFabric::yarns
    bool gap = false;
    float irradiance = 1; // I_p, cosine irradiance under a uniform sky (math.md 8.1), [0, 1]
};

// The bit layout. x: slope x in bits 0-15, slope y in 16-31, int16, slope = 4 v / 32767. y: azimuth in bits 0-15
// (phi = pi v / 65536), yarn type 16-22, gap 23, I_p 24-31 (unorm8).
glm::uvec2 pack_texel(const Texel& texel);
Texel unpack_texel(glm::uvec2 words);
glm::uint pack_slope(glm::vec2 slope);
glm::vec2 unpack_slope(glm::uint word);
glm::uvec2 pack_knots(const float knots[8]);
void unpack_knots(glm::uvec2 words, float knots[8]);
// An elliptic cap as cloth_cap_visibility reads it. x: x and y of the unit mean direction (z >= 0), snorm16 each. y:
// azimuth gamma of the first axis about cloth_frame of the mean in bits 0-9 (pi v / 1024), the axes in units of
// cloth_cap_axis_max: 11 bits each.
glm::uvec2 pack_cap(glm::vec4 mean_gamma, glm::vec2 axes);

// Size and first word of mip level L >= 1 in slope_mips; level_count counts level 0 (so 1x1 is level_count - 1).
int slope_level_count(glm::ivec2 size);
glm::ivec2 slope_level_size(glm::ivec2 size, int level);
std::size_t slope_level_offset(glm::ivec2 size, int level);

} // namespace selvedge
