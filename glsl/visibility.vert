// Root: puts the triangles of one object where this frame's jittered rays see them. No maths of the cloth.
#include "interop.h"
#include "blocks.h"

layout(location = 0) in vec3 position;

void main()
{
    // Coordinates in the camera's axes, as cloth_camera_ray builds rays from them. The y axis points down, as raster rows do.
    vec3 d = position - frame.camera_position.xyz;
    float w = dot(d, frame.camera_forward.xyz);
    float x = dot(d, frame.camera_right.xyz) * frame.camera_right.w - frame.lens.x * w;
    float y = dot(d, frame.camera_up.xyz) * frame.camera_up.w - frame.lens.y * w;
    vec2 shift = 2.0 * frame.film.zw / frame.film.xy;
    // Reversed depth without a far plane: near / w. Where the depth range is [-1, 1] the same depth is 2 near / w - 1.
    float depth = frame.camera_forward.w;
    gl_Position = vec4(x - shift.x * w, -y - shift.y * w, frame.depth.x != 0 ? depth : 2.0 * depth - w, w);
}
