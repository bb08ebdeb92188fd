// Root of the tests: runs ROW_BODY, one row of shared_rows.h, for each row of numbers. tests/evaluate.py defines ROW_BODY,
// ROW_INPUTS, ROW_OUTPUTS, the extents of the bound maps and the lights.
#include "interop.h"
#include "cloth.h"

layout(local_size_x = 64) in;
layout(std430, binding = 0) readonly buffer In { float xs[]; };
layout(std430, binding = 1) writeonly buffer Out { float ys[]; };

uint row;

float in1(int k)
{
    return xs[row * ROW_INPUTS + uint(k)];
}

void out1(int k, float v)
{
    ys[row * ROW_OUTPUTS + uint(k)] = v;
}

ClothMaps in_maps()
{
    return ClothMaps(ivec2(MAPS_SIZE), MAPS_TEXELS, MAPS_HORIZONS, ivec2(MAPS_MIPS), 0, 0, 0, vec2(1.0), vec2(0.0), vec2(0.0), ivec2(1), 0.0);
}

ClothLights in_lights()
{
    return ClothLights(LIGHTS_COUNT, ivec2(LIGHTS_SIZE));
}

#include "shared_inputs.h"

void main()
{
    row = gl_GlobalInvocationID.x;
    if (row < xs.length() / ROW_INPUTS) {
        ROW_BODY
    }
}
