// The C++ door to the shared shading source: cloth::f32 is the shader's arithmetic, cloth::f64 the oracle that tests trust.
// Imports glm and the shared headers; everything in C++ that shades includes this file and none of them.
#pragma once
#define CLOTH_BSDF_HPP
#include <cmath>
#include <cstdint>
#include <glm/glm.hpp>
#ifdef __SSE__
#include <immintrin.h>
#endif
#include "interop.h"

namespace cloth {

inline std::uint32_t cloth_reverse_bits(std::uint32_t x)
{
    x = __builtin_bswap32(x);
    x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
    x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
    return ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
}

inline std::uint32_t cloth_multiply_high(std::uint32_t a, std::uint32_t b)
{
    return static_cast<std::uint32_t>((std::uint64_t(a) * b) >> 32);
}

// Those of glm are comparisons, of which GCC makes branches that a processor can only guess.
using glm::clamp;
using glm::max;
using glm::min;

#ifdef __SSE__
inline float min(float x, float y)
{
    return _mm_cvtss_f32(_mm_min_ss(_mm_set_ss(y), _mm_set_ss(x)));
}

inline float max(float x, float y)
{
    return _mm_cvtss_f32(_mm_max_ss(_mm_set_ss(y), _mm_set_ss(x)));
}

inline float clamp(float x, float low, float high)
{
    return min(max(x, low), high);
}
#endif

// Angle of (x, y), within 4e-7 rad; that of (0, 0) is 0. With the C library's a sample of the demo under its sky alone takes 3 % longer.
//   source  Abramowitz & Stegun 1964, 4.4.49
inline float atan(float y, float x)
{
    const float ax = std::fabs(x), ay = std::fabs(y), larger = max(ax, ay);
    const float t = min(ax, ay) / max(larger, 1e-37f), t2 = t * t;
    const float high = ((-0.0040540580f * t2 + 0.0218612288f) * t2 - 0.0559098861f) * t2 + 0.0964200441f;
    const float p    = (((high * t2 - 0.1390853351f) * t2 + 0.1994653599f) * t2 - 0.3332985605f) * t2 + 0.9999993329f;
    // Mirrored at the diagonal and at the y axis where (x, y) lies beyond: |0 - a| is a.
    float angle = std::fabs(float(ax < ay) * 1.57079632679f - p * t);
    angle       = std::fabs(float(x < 0.0f) * 3.14159265359f - angle);
    return std::copysign(angle, y);
}
using glm::atan;

inline float abs(float x)
{
    return std::fabs(x);
}

inline double abs(double x)
{
    return std::fabs(x);
}

}   // namespace cloth

namespace cloth::f32 {
using namespace glm;
using real = float;
using real2 = vec2;
using real3 = vec3;
using real4 = vec4;
#include "cloth.h"
}   // namespace cloth::f32

namespace cloth::f64 {
using namespace glm;
using real = double;
using real2 = dvec2;
using real3 = dvec3;
using real4 = dvec4;
#include "cloth.h"
}   // namespace cloth::f64
