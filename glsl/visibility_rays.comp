// Root: what each pixel of this frame sees, by rays in a compute shader.
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "visibility_rays.h"
#include "dispatch.h"

layout(binding = 3, rgba32ui) restrict writeonly uniform uimage2D id_image;

void main()
{
    ivec2 pixel = own_pixel();
    if (pixel.x >= 0) imageStore(id_image, pixel, first_met(vec2(pixel) + 0.5));
}
