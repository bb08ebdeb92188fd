// Root: shade.frag where a pixel sees nothing of the scene, whatever point of filter and lens its ray comes from.
//   SQUARES  the spread of frames is asked for
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"

layout(location = 0) out vec4 colour;   // radiance, coverage
layout(location = 1) out uvec2 stopped_by;
#ifdef SQUARES
layout(location = 2) out vec4 squares;   // of `colour`
#endif

void main()
{
    colour     = background(frame_ray(gl_FragCoord.xy));
    stopped_by = uvec2(0u);
#ifdef SQUARES
    squares = colour * colour;
#endif
}
