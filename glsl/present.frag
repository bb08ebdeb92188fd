// Root: the accumulated picture through the display transform, for the window.
#include "interop.h"
#include "color.h"

uniform sampler2D block_sum;
uniform sampler2D mean_map;
uniform float block_weight;   // of the sum of the unfinished block: 1 / samples
uniform float mean_weight;    // of the mean of the finished blocks: their share of the samples
uniform float exposure;       // stops
uniform float left;           // of the viewport in the window [px]
uniform float top;            // upper edge of the viewport, counted from below [px]
uniform float stretch_x;      // pixels of the picture in one of the window
uniform float stretch_y;
layout(location = 0) out vec4 colour;

void main()
{
    ivec2 size = textureSize(block_sum, 0);
    ivec2 xy   = clamp(ivec2((gl_FragCoord.x - left) * stretch_x, (top - gl_FragCoord.y) * stretch_y), ivec2(0), size - 1);
    vec4 value = texelFetch(block_sum, xy, 0) * block_weight + texelFetch(mean_map, xy, 0) * mean_weight;
    colour     = vec4(cloth_display(value.rgb, exposure), 1.0);
}
