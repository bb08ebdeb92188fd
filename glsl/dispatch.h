// A pass over the pixels of the picture as a compute shader. GLSL only; roots that end in .comp include it after blocks.h.
//   TILES  some are finished, and drawn no more

layout(local_size_x = 8, local_size_y = 4) in;

#ifdef TILES
uniform usamplerBuffer drawn_tiles;   // R8UI, row by row: 0 finished
uniform int tile_side;                // [px]
#endif

// This invocation's pixel; negative: it has none.
ivec2 own_pixel()
{
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = ivec2(frame.film.xy);
    bool drawn  = all(lessThan(pixel, size));
#ifdef TILES
    ivec2 tile = pixel / tile_side;
    if (drawn) drawn = texelFetch(drawn_tiles, tile.y * ((size.x + tile_side - 1) / tile_side) + tile.x).x != 0u;
#endif
    return drawn ? pixel : ivec2(-1);
}
