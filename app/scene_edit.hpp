// app/scene_edit.hpp: live edits of a loaded scene's fabrics. Included by window.cpp.
#pragma once

#include <cstddef>

#include "reference/scene.hpp"

namespace selvedge
{

// Makes the yarn types of a fabric anew from its source.
//   return  false where their number has changed: bake_again() then
bool shade_again(Scene& scene, std::size_t fabric);

// Bakes a fabric anew from its source; where the size of the repeat has changed, UVs follow, so that metres stay
// metres.
//   throws  InputError; the scene is then as before
void bake_again(Scene& scene, std::size_t fabric);

} // namespace selvedge
