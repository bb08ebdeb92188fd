// Root: what each half of the blocks says of a tile's noise, for adaptive sampling (reference/adaptive.hpp). A pixel of the target
// is a tile of the picture.
uniform sampler2D mean_map;         // mean of the even blocks so far
uniform sampler2D spread_map;       // sum of (block mean - mean)^2 over them
uniform sampler2D odd_mean_map;     // likewise of the odd ones
uniform sampler2D odd_spread_map;
uniform int side;                   // of a tile [px]
layout(location = 0) out vec4 spread;   // x even, y odd blocks: sum over pixels and channels of relative squared deviations; z their count

float relative(vec4 deviations, vec4 mean)
{
    return dot(deviations.rgb / (mean.rgb * mean.rgb + 0.01), vec3(1.0));
}

void main()
{
    ivec2 first = ivec2(gl_FragCoord.xy) * side, end = min(first + side, textureSize(mean_map, 0));
    vec2 sum    = vec2(0.0);
    for (int y = first.y; y < end.y; ++y)
        for (int x = first.x; x < end.x; ++x) {
            ivec2 xy = ivec2(x, y);
            sum.x += relative(texelFetch(spread_map, xy, 0), texelFetch(mean_map, xy, 0));
            sum.y += relative(texelFetch(odd_spread_map, xy, 0), texelFetch(odd_mean_map, xy, 0));
        }
    spread = vec4(sum, 3.0 * float((end.x - first.x) * (end.y - first.y)), 0.0);
}
