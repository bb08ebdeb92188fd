// Root: what every pixel shows of this frame; the blend unit adds it to the sum of the block.
//   SQUARES  the spread of frames is asked for
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#include "trace.h"
#include "shade.h"

layout(location = 0) out vec4 colour;   // radiance, coverage
layout(location = 1) out uvec2 stopped_by;
#ifdef SQUARES
layout(location = 2) out vec4 squares;   // of `colour`
#endif

void main()
{
    colour     = mean_colour(gl_FragCoord.xy);
    stopped_by = seen;
#ifdef SQUARES
    squares = colour * colour;
#endif
}
