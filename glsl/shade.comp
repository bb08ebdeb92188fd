// Root: shade.frag as a compute shader, which adds by itself. Cards for computing draw fragments with a few of their processors.
//   SQUARES  the spread of frames is asked for
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#include "trace.h"
#include "shade.h"
#include "dispatch.h"

layout(binding = 0, rgba32f) restrict uniform image2D sum_image;
layout(binding = 1, rg32ui) restrict writeonly uniform uimage2D seen_image;
#ifdef SQUARES
layout(binding = 2, rgba32f) restrict uniform image2D squares_image;
#endif

void main()
{
    ivec2 pixel = own_pixel();
    if (pixel.x < 0) return;
    vec4 colour = mean_colour(vec2(pixel) + 0.5);
    imageStore(sum_image, pixel, imageLoad(sum_image, pixel) + colour);
    imageStore(seen_image, pixel, uvec4(seen, 0u, 0u));
#ifdef SQUARES
    imageStore(squares_image, pixel, imageLoad(squares_image, pixel) + colour * colour);
#endif
}
