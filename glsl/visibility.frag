// Root: which triangle each pixel of this frame sees; where several samples share its ray, the first that it meets. GAPS: the object's fabric has gaps, and fragments whose selection
// passes are thrown away, so that the nearest layer that stops the ray remains, whatever the order of drawing.
#include "interop.h"
#ifdef GAPS
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#endif

uniform int object_index;
layout(location = 0) out uvec4 id;   // object + 1, triangle, and where in the cloth: see hand_over in scene_buffers.h

void main()
{
#ifdef GAPS
    SceneObject object   = fetch_object(object_index);
    ClothSurface surface = cloth_surface(fetch_triangle(object.first_triangle + gl_PrimitiveID), frame_ray(gl_FragCoord.xy));
    ClothRandom random   = layer_random(ClothRandom(pixel_seed(gl_FragCoord.xy), frame.random.y, 0u), object_index, gl_PrimitiveID);
    ClothFootprint footprint = footprint_on(object, gl_PrimitiveID, surface);
    vec2 u               = cloth_draw(random, cloth_dim_pick);
    ClothPlace place     = cloth_find(object.maps, surface.side, footprint, surface.wo, frame_settings(), random, u.x);
    if (cloth_meet(object.maps, surface.side, footprint, place, surface.wo, frame_settings(), u.y, false).passes) discard;
    id = uvec4(uint(object_index) + 1u, uint(gl_PrimitiveID), hand_over(place));
#else
    id = uvec4(uint(object_index) + 1u, uint(gl_PrimitiveID), 0u, 0u);
#endif
}
