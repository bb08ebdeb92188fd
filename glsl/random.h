// Counter-based random numbers and Owen-scrambled Sobol points. Pure: a number is a function of (seed, index, dimension).
// Shared by both renderers; imports interop.h.

// Which decision of a light path a pair of random numbers serves. One row per decision keeps them independent.
CLOTH_CONST uint cloth_dim_pixel     = 0u;   // position inside the pixel filter
CLOTH_CONST uint cloth_dim_footprint = 1u;   // position inside the pixel footprint
CLOTH_CONST uint cloth_dim_texel     = 2u;   // position inside a texel: stochastic bilinear filter
CLOTH_CONST uint cloth_dim_pick      = 3u;   // which candidate is seen; whether a gap lets the ray pass
CLOTH_CONST uint cloth_dim_light     = 4u;   // which light, light or BSDF sampling; roulette of the shadow ray
CLOTH_CONST uint cloth_dim_emitter   = 5u;   // place in the environment; triangle of an emitter
CLOTH_CONST uint cloth_dim_subtexel  = 6u;   // position on the light
CLOTH_CONST uint cloth_dim_lobe      = 7u;   // which lobe of the BSDF; roulette
CLOTH_CONST uint cloth_dim_direction = 8u;   // direction inside the lobe
CLOTH_CONST uint cloth_dim_lens      = 9u;   // position on the camera's lens
CLOTH_CONST uint cloth_dims_per_vertex = 16u;

// Integer hash with low bias, all 32 bits avalanche.
//   source  C. Wellons 2018, "Prospecting for Hash Functions", lowbias32
CLOTH_FN uint cloth_hash(uint x)
{
    x ^= x >> 16u;
    x *= 0x7feb352du;
    x ^= x >> 15u;
    x *= 0x846ca68bu;
    x ^= x >> 16u;
    return x;
}

CLOTH_FN uint cloth_hash_combine(uint seed, uint value)
{
    return cloth_hash(seed ^ (value + 0x9e3779b9u + (seed << 6u) + (seed >> 2u)));
}

// 32 random bits to [0, 1): 24 bits, so that the largest value stays below 1 in float (math.md hazard 26).
CLOTH_FN real cloth_unit(uint bits)
{
    return real(bits >> 8u) * real(5.9604644775390625e-8);
}

// Owen scramble of bit-reversed input; the caller reverses the result.
//   source  Laine & Karras 2011, "Stratified sampling for stochastic transparency", with the constants of
//           N. Vegdahl 2021, "Building a Better LK Hash"
CLOTH_FN uint cloth_scramble(uint x, uint seed)
{
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

// The second Sobol dimension before bit reversal: multiplication by the Pascal matrix modulo 2, factored into five steps.
//   source  Ahmed 2024, "An Implementation Algorithm of 2D Sobol Sequence Fast, Elegant, and Compact"
CLOTH_FN uint cloth_pascal(uint x)
{
    x ^= (x >> 16u);
    x ^= (x & 0xff00ff00u) >> 8u;
    x ^= (x & 0xf0f0f0f0u) >> 4u;
    x ^= (x & 0xccccccccu) >> 2u;
    x ^= (x & 0xaaaaaaaau) >> 1u;
    return x;
}

// 2 x 32 random bits: point `index` of a shuffled, Owen-scrambled (0,2)-sequence that belongs to (seed, dimension).
//   source  Burley 2020, "Practical Hash-based Owen Scrambling" (shuffling and padding)
CLOTH_FN uvec2 cloth_random_bits(uint seed, uint index, uint dimension)
{
    uint key      = cloth_hash_combine(seed, dimension);
    uint shuffled = cloth_reverse_bits(cloth_scramble(cloth_reverse_bits(index), key));
    uint x        = cloth_reverse_bits(cloth_scramble(shuffled, cloth_hash(key ^ 0xa511e9b3u)));
    uint y        = cloth_reverse_bits(cloth_scramble(cloth_pascal(shuffled), cloth_hash(key ^ 0x63d83595u)));
    return uvec2(x, y);
}

CLOTH_FN real2 cloth_random(uint seed, uint index, uint dimension)
{
    uvec2 bits = cloth_random_bits(seed, index, dimension);
    return real2(cloth_unit(bits.x), cloth_unit(bits.y));
}

// A stream of random numbers: one pixel, one block of samples, one vertex of the path.
struct ClothRandom {
    uint seed;     // hash of pixel, block, and whatever else must be independent
    uint index;    // sample inside the block
    uint offset;   // first dimension of this vertex
#ifdef __cplusplus
    const uvec2* drawn = nullptr;   // the bits of this vertex by dimension, where somebody has drawn them for many streams at once
#endif
};

CLOTH_FN uvec2 cloth_draw_bits(ClothRandom random, uint dimension)
{
#ifdef __cplusplus
    if (random.drawn) return random.drawn[dimension];
#endif
    return cloth_random_bits(random.seed, random.index, random.offset + dimension);
}

CLOTH_FN real2 cloth_draw(ClothRandom random, uint dimension)
{
    uvec2 bits = cloth_draw_bits(random, dimension);
    return real2(cloth_unit(bits.x), cloth_unit(bits.y));
}

// Samples come in blocks. Inside a block the points are stratified; blocks are independent, so the spread of their means
// is an unbiased estimate of the error, which stratified samples on their own do not give.
//   planned  samples that will be taken, 0 when nobody knows
//   return   power of two in [1, 64]; at least 16 blocks where the count is known
CLOTH_FN uint cloth_block_length(uint planned)
{
    uint length = 64u;
    while (planned > 0u && length > 1u && length * 16u > planned) length /= 2u;
    return length;
}
