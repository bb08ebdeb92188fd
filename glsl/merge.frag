// Root: folds the mean of a finished block of samples into the mean of all blocks and the sum of squared deviations
// (Welford 1962). What rounding takes from the mean is kept beside it (Knuth's exact addition): over thousands of blocks the
// roundings of 32-bit floats would add up.
uniform sampler2D block_sum;    // sum of the block
uniform sampler2D mean_map;     // mean of the blocks so far
uniform sampler2D spread_map;   // sum of (block mean - mean)^2
uniform sampler2D rest_map;     // exact mean less mean_map
uniform float block_length;
uniform float blocks;           // this one included
layout(location = 0) out vec4 mean;
layout(location = 1) out vec4 spread;
layout(location = 2) out vec4 rest;

void main()
{
    ivec2 xy   = ivec2(gl_FragCoord.xy);
    vec4 value = texelFetch(block_sum, xy, 0) / block_length;
    vec4 old   = texelFetch(mean_map, xy, 0);
    vec4 left  = texelFetch(rest_map, xy, 0);
    vec4 delta = (value - old) - left;
    precise vec4 change  = delta / blocks + left;
    precise vec4 sum     = old + change;
    precise vec4 changed = sum - old;
    precise vec4 lost    = (old - (sum - changed)) + (change - changed);
    mean       = sum;
    rest       = lost;
    spread     = texelFetch(spread_map, xy, 0) + delta * (value - mean);
}
