// Root: what visibility.frag finds, by rays through the BVH. Software GL prepares every triangle of a scene for its rasteriser by one
// core; where there are more of them than pixels, rays cost less.
//   GAPS  fabrics have gaps, and a ray goes on behind what it passes
#define CAMERA_RAYS
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#include "trace.h"
#include "gauze.h"

layout(location = 0) out uvec4 id;

void main()
{
    ClothRay ray = frame_ray(gl_FragCoord.xy);
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
            if (object.gaps) passes = passes_gauze(object, hit.object, hit.triangle, ray, gl_FragCoord.xy, found);
        }
#endif
    } while (passes);
    id = uvec4(uint(hit.object + 1), uint(max(hit.triangle, 0)), found);
}
