// What visibility.frag finds, by rays through the BVH. Software GL prepares every triangle of a scene for its rasteriser by one
// core; where there are more of them than pixels, rays cost less. GLSL only; visibility_rays.frag and .comp include it after blocks.h.
//   GAPS  fabrics have gaps, and a ray goes on behind what it passes
#define CAMERA_RAYS
#include "scene_buffers.h"
#include "trace.h"
#include "gauze.h"

// object + 1, triangle, and where in the cloth: see hand_over in scene_buffers.h
uvec4 first_met(vec2 pixel_centre)
{
    ClothRay ray = frame_ray(pixel_centre);
    Hit hit      = Hit(-1, -1, 0.0);
    uvec2 found;
    bool passes;
    do {
        hit    = closest(ray.origin, ray.direction, hit);
        found  = uvec2(0u);
        passes = false;
#ifdef GAPS
        if (hit.object >= 0) {
            SceneObject object = fetch_object(hit.object);
            if (object.gaps) passes = passes_gauze(object, hit.object, hit.triangle, ray, pixel_centre, found);
        }
#endif
    } while (passes);
    return uvec4(uint(hit.object + 1), uint(max(hit.triangle, 0)), found);
}
