// The uniform block of a frame: one text for C++ and GLSL. vec4, ivec4, uvec4 members only, so that std140 and C++ agree.
// C++ includes it through app/preview/passes.hpp, which holds the offsets to it; GLSL roots include it before scene_buffers.h.
#ifdef __cplusplus
#define CLOTH_BLOCK(name) struct name
#define CLOTH_BLOCK_END(instance)
#else
#define CLOTH_BLOCK(name) layout(std140) uniform name
#define CLOTH_BLOCK_END(instance) instance
#endif

CLOTH_BLOCK(Frame) {
    vec4 camera_position;   // xyz [m]
    vec4 camera_forward;    // xyz unit; w distance of the near plane [m]
    vec4 camera_right;      // xyz unit times tan(half horizontal field of view); w 1 / squared length
    vec4 camera_up;         // likewise, vertical
    vec4 lens;              // xy of this frame's point of the lens: what it adds to the view direction, in units of right and up
    vec4 film;              // xy resolution [px]; zw offset of this frame's samples from the pixel centres [px]
    uvec4 random;           // x seed of the block of samples; y first sample inside the block; z samples a frame; w surfaces along a path, at most
    ivec4 depth;            // x 1: depth range is [0, 1]
    ivec4 lights;           // x count; yz size of the environment; w nodes of the BVH
    ivec4 model;            // bsdf, weight, visibility, slab: where the shader does not have them as constants
    ivec4 ingredients;      // x unscattered; y interreflection; z twist noise: 1 or 0, likewise
    vec4 past_position;     // the camera of the remembered view, as above; w unused here and in past_forward
    vec4 past_forward;
    vec4 past_right;
    vec4 past_up;
} CLOTH_BLOCK_END(frame);
