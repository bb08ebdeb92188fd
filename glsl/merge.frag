// Root: folds the mean of a finished block of samples into the mean of all blocks and the sum of squared deviations
// (Welford 1962), so that 32-bit floats lose nothing over any number of frames.
uniform sampler2D block_sum;    // sum of the block
uniform sampler2D mean_map;     // mean of the blocks so far
uniform sampler2D spread_map;   // sum of (block mean - mean)^2
uniform float block_length;
uniform float blocks;           // this one included
layout(location = 0) out vec4 mean;
layout(location = 1) out vec4 spread;

void main()
{
    ivec2 xy   = ivec2(gl_FragCoord.xy);
    vec4 value = texelFetch(block_sum, xy, 0) / block_length;
    vec4 old   = texelFetch(mean_map, xy, 0);
    vec4 delta = value - old;
    mean       = old + delta / blocks;
    spread     = texelFetch(spread_map, xy, 0) + delta * (value - mean);
}
