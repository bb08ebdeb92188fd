// The dialect: the only shared file that knows which language is compiling it. Included first, by roots only.
// C++ sees it through cloth_bsdf.hpp, which defines real, real2, real3, real4 for each precision.
#ifdef __cplusplus
#define CLOTH_FN inline
#define CLOTH_RARE_FN [[gnu::noinline]] inline   // out of the way of what is asked for often
#define CLOTH_CONST inline constexpr
#define CLOTH_IN(type) const type&   // a struct too large to be copied
#define CLOTH_INOUT(type) type&
#else
#define CLOTH_FN
#define CLOTH_RARE_FN
#define CLOTH_CONST const
#define CLOTH_IN(type) type
#define CLOTH_INOUT(type) inout type
#define real float
#define real2 vec2
#define real3 vec3
#define real4 vec4
uint cloth_reverse_bits(uint x)
{
    return bitfieldReverse(x);
}
uint cloth_multiply_high(uint a, uint b)
{
    uint high, low;
    umulExtended(a, b, high, low);
    return high;
}
#endif
