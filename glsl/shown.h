// What is on show: the accumulated picture of the present view, and, while that has few samples, what earlier views knew of the
// same places. GLSL only; present.frag and remember.frag include it.
//   TILES  tiles end by themselves: reference/adaptive.hpp   DENOISED  of the accumulated picture its filtered copy

uniform sampler2D block_sum;
uniform sampler2D mean_map;      // TILES: of the even blocks
#ifdef TILES
uniform sampler2D odd_mean_map;
uniform sampler2D kept_map;      // what finished tiles show
uniform sampler2D kept_noise_map;
uniform float odd_mean_weight;
#endif
uniform sampler2D carried_map;   // rgb picture of earlier views, a samples that it stands for; see carry.frag
uniform float block_weight;      // of the sum of the unfinished block: 1 / samples
uniform float mean_weight;       // of the mean of the finished blocks: their share of the samples
uniform float samples;           // of the present view
uniform float carried_share;     // of the earlier views' weight that still counts, [0, 1]; 0: carried_map is not there

#ifdef DENOISED
uniform sampler2D denoised_map;
#endif

// rgb picture, a samples that it stands for.
vec4 shown_at(ivec2 xy)
{
#ifdef DENOISED
    return vec4(texelFetch(denoised_map, xy, 0).rgb, samples);
#endif
    vec3 present = (texelFetch(block_sum, xy, 0) * block_weight + texelFetch(mean_map, xy, 0) * mean_weight).rgb;
#ifdef TILES
    if (texelFetch(kept_noise_map, xy, 0).a == 2.0) return vec4(texelFetch(kept_map, xy, 0).rgb, samples);
    present += texelFetch(odd_mean_map, xy, 0).rgb * odd_mean_weight;
#endif
    if (carried_share <= 0.0) return vec4(present, samples);
    vec4 carried = texelFetch(carried_map, xy, 0);
    float weight = carried.a * carried_share;
    return vec4((present * samples + carried.rgb * weight) / (samples + weight), samples + weight);
}
