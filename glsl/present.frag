// Root: the accumulated picture through the display transform, for the window.
#include "interop.h"
#include "color.h"
#include "shown.h"

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
    colour     = vec4(cloth_display(shown_at(xy).rgb, exposure), 1.0);
}
