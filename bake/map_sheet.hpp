// bake/map_sheet.hpp: pictures of a packed fabric for people: the preview sheet and the EXR layers. selvedge-bake uses
// it.
#pragma once

#include "image.hpp"
#include "pack.hpp"

namespace selvedge
{

// All maps on one sheet, front side above, back side below (v upwards in each): yarn types (gaps magenta), normal
// (x, y, z to red, green, blue), tangent azimuth (hue), height (black low, white high), cosine irradiance I_p, mean
// horizon (white: nothing hidden). Display-referred R, G, B.
Image draw_map_sheet(const PackedFabric& fabric);

// The maps as numbers, at full resolution: front.height (m), front.slope.x/y, front.azimuth (rad), front.yarn,
// front.gap, front.irradiance, front.stacked, front.horizon0-7 (nearest); back.* likewise. Row 0 of the picture is v
// = 1.
Image map_layers(const PackedFabric& fabric);

} // namespace selvedge
