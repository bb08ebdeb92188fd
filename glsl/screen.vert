// Root: one triangle that covers the viewport; TILES, BLOCK_SIDE: what app/preview/passes.cpp has laid out, that triangle, the tiles
// that are not finished, or blocks.
#if defined(TILES) || defined(BLOCK_SIDE)
layout(location = 0) in vec2 corner;   // clip space
#endif

void main()
{
#if defined(TILES) || defined(BLOCK_SIDE)
    gl_Position = vec4(corner, 0.0, 1.0);
#else
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
#endif
}
