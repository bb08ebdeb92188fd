// Root: which triangle each pixel of this frame sees; where several samples share its ray, the first that it meets. GAPS: the object's
// fabric has gaps, and fragments whose selection passes are thrown away, so that the nearest layer that stops the ray remains, whatever
// the order of drawing.
#include "interop.h"
#ifdef GAPS
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#include "gauze.h"
#endif

uniform int object_index;
layout(location = 0) out uvec4 id;   // object + 1, triangle, and where in the cloth: see hand_over in scene_buffers.h

void main()
{
    uvec2 found = uvec2(0u);
#ifdef GAPS
    if (passes_gauze(fetch_object(object_index), object_index, gl_PrimitiveID, frame_ray(gl_FragCoord.xy), gl_FragCoord.xy, found)) discard;
#endif
    id = uvec4(uint(object_index) + 1u, uint(gl_PrimitiveID), found);
}
