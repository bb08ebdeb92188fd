// Root: in tiles where adaptive sampling has ended one half of the blocks, that half's part of the picture; the blend unit adds the
// two halves up.
uniform sampler2D mean_map;     // of the half
uniform sampler2D spread_map;
uniform float blocks;           // of the half, so far
layout(location = 0) out vec4 kept;        // half its mean
layout(location = 1) out vec4 kept_noise;  // rgb variance of that; a halves that have ended

void main()
{
    ivec2 xy   = ivec2(gl_FragCoord.xy);
    kept       = 0.5 * texelFetch(mean_map, xy, 0);
    kept_noise = vec4(0.25 * texelFetch(spread_map, xy, 0).rgb / (blocks * (blocks - 1.0)), 1.0);
}
