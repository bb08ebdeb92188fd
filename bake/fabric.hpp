// bake/fabric.hpp: a fabric as the artist states it: pattern, yarns, resolution. Input of bake.hpp.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "draft.hpp"
#include "json.hpp"
#include "knit.hpp"
#include "pack.hpp"

namespace selvedge
{

// Section of a woven yarn: an ellipse, or the race-track of A. Kemp, "An extension of Peirce's cloth geometry to the
// treatment of non-circular threads", Journal of the Textile Institute 49 (1958): a rectangle between two half circles.
// The plies of a yarn have its section, too.
enum class YarnSection { ellipse, racetrack };

// Everything about the warp's or the weft's yarns. Defaults are a medium cotton. Ranges: params.hpp.
struct YarnSpec {
    // geometry: changes ask for a bake
    float spacing_m = 0.0005f;                  // mean distance of neighbouring yarn axes
    float width_m = 0.00045f;                   // mean width of the yarns
    float aspect = 0.6f;                        // height over width of the section
    YarnSection section = YarnSection::ellipse; // racetrack: aspect at most 1
    int plies = 2;
    float ply_twist_deg = 25;     // plies to yarn axis, Z positive
    std::optional<float> crimp;   // share of the crimp that these yarns take, [0, 1]; both absent: half each
    std::optional<float> tex;     // linear density of the whole yarn, g/km: the width where none was stated
    std::string fibre = "cotton"; // row of `fibres` in params.hpp
    // shading: changes ask for nothing but shade_yarns()
    float fibre_twist_deg = -15;                   // fibres to ply axis
    glm::vec3 albedo{0.6f};                        // of the fibres, reflection lobe
    std::optional<glm::vec3> albedo_transmission;  // absent: albedo
    std::optional<glm::vec3> diffuse;              // both absent: from the slab's own multiple scattering, math.md 9.2;
    std::optional<glm::vec3> diffuse_transmission; // one absent of the two: that one is 0
    float roughness = 0.3f;
    std::optional<float> roughness_transmission; // absent: roughness
    float thickness = 2.0f;                      // optical thickness
    float diffuse_mix = 1.0f;                    // w of math.md 4.1
};

struct Fabric {
    std::string name;
    std::string path;    // of the JSON or WIF file; empty when made in memory
    std::string pattern; // "twill 2/2", "rows", or the path of the WIF or text
    // Its spacings and thicknesses count as proportions: thread i has spacing_m * draft spacing i / their mean.
    Draft draft;
    // A knit has no draft and no warp: its yarn is `weft`, which runs along the courses.
    std::optional<KnitPattern> knit;
    float wale_spacing_m = 0, course_spacing_m = 0;
    std::optional<float> loop_length_m; // absent: Peirce's, see knit_yarns.hpp
    YarnSpec warp, weft;
    bool use_draft_colours = false; // tint yarns by the draft's colours: one yarn type for each colour that is used
    float irregularity_deg = 5;     // mean deviation of the fibre twist: N(p) of the paper, 4.1
    float irregularity_length_m = 0.0015f; // distance over which it changes
    int resolution = 256;                  // texels along the longer side of the tile
    VisibilityKind visibility = VisibilityKind::horizon8;
    std::vector<std::string> warnings;
};

// A fabric JSON, or a bare draft (name ends in .wif, or .txt for rows of x and dots), which takes default yarns with
// the draft's colours. Spacing and width that the JSON does not state come from the draft, where that states them.
//   throws  InputError file:line: key: found, expected
Fabric load_fabric(const std::string& path, const Overrides& overrides = {});
// The same from a parsed value (a fabric written inside a scene).
Fabric parse_fabric(const JsonValue& value);

// Which yarn each thread is made of; never more than yarn_type_limit types (more colours are merged, with a warning).
struct YarnTypes {
    struct Type {
        bool warp;
        glm::vec3 tint;   // multiplies albedo and diffuse
        std::string name; // "warp", "weft #2f4f9a", "yarn"
    };
    std::vector<Type> types;
    std::vector<int> end_type, pick_type; // one for each thread of the draft; a knit has one type for each strand
    std::string warning;                  // empty if nothing was merged
};
YarnTypes yarn_types(const Fabric& fabric);

VisibilityKind parse_visibility(const std::string& word); // throws UsageError
const char* visibility_name(VisibilityKind kind);

// n equal plies about the axis of a yarn of radius 1: x their radius, y that of their helix.
glm::vec2 ply_radii(int plies);

// Width of a yarn of `tex` g/km whose plies are so flat: fibre volume over packing (params.hpp) over the share of the
// section that plies fill. Metres.
float width_of_tex(const YarnSpec& yarn, float tex);

} // namespace selvedge
