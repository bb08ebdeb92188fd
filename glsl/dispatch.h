// A pass over the pixels of the picture as a compute shader. GLSL only; roots that end in .comp include it after blocks.h.
//   GROUP_X, GROUP_Y  pixels of a work group   TILES  some of TILE_SIDE pixels a side are finished, and drawn no more

layout(local_size_x = GROUP_X, local_size_y = GROUP_Y) in;

#ifdef TILES
uniform usamplerBuffer drawn_tiles;   // R8UI, row by row: 0 finished
#endif

// This invocation's pixel; negative: it has none.
ivec2 own_pixel()
{
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = ivec2(frame.film.xy);
    bool drawn  = all(lessThan(pixel, size));
#ifdef TILES
    ivec2 tile = pixel / TILE_SIDE;
    if (drawn) drawn = texelFetch(drawn_tiles, tile.y * ((size.x + TILE_SIDE - 1) / TILE_SIDE) + tile.x).x != 0u;
#endif
    return drawn ? pixel : ivec2(-1);
}
