// What the rows of shared_rows.h read and write, in the dialect of glsl/interop.h. Imports the shared source and, from whoever
// includes it (evaluate.comp, cpp/evaluate_main.cpp): in1, out1, in_maps, in_lights. k counts numbers in a row.

CLOTH_FN real2 in2(int k)
{
    return real2(in1(k), in1(k + 1));
}

CLOTH_FN real3 in3(int k)
{
    return real3(in1(k), in1(k + 1), in1(k + 2));
}

CLOTH_FN int in_int(int k)
{
    return int(in1(k));
}

// 32 bits travel as two numbers, low half first: a float holds 16 bits exactly, and NaN patterns come to no harm.
CLOTH_FN uint in_word(int k)
{
    return uint(in1(k)) | (uint(in1(k + 1)) << 16u);
}

CLOTH_FN void out2(int k, real2 v)
{
    out1(k, v.x);
    out1(k + 1, v.y);
}

CLOTH_FN void out3(int k, real3 v)
{
    out1(k, v.x);
    out1(k + 1, v.y);
    out1(k + 2, v.z);
}

CLOTH_FN void out_word(int k, uint word)
{
    out1(k, real(word & 0xffffu));
    out1(k + 1, real(word >> 16u));
}

CLOTH_FN ClothPoint in_point(int k)   // 11
{
    return ClothPoint(in3(k), in3(k + 3), in3(k + 6), in3(k + 6), in1(k + 9), in1(k + 10));
}

CLOTH_FN ClothYarn in_yarn(int k)   // 17
{
    return ClothYarn(in3(k), in3(k + 3), in3(k + 6), in3(k + 9), in1(k + 12), in1(k + 13), in1(k + 14), real2(cos(in1(k + 15)), sin(in1(k + 15))), in1(k + 16), real3(real(0)), real3(real(0)), real3(real(0)), real(0), in1(k + 14));
}

CLOTH_FN ClothTriangle in_triangle(int k)   // 24
{
    return ClothTriangle(in3(k), in3(k + 3), in3(k + 6), in3(k + 9), in3(k + 12), in3(k + 15), in2(k + 18), in2(k + 20), in2(k + 22));
}

CLOTH_FN ClothRay in_ray(int k)   // 12
{
    return ClothRay(in3(k), in3(k + 3), in3(k + 6), in3(k + 9));
}

CLOTH_FN ClothFootprint in_footprint(int k)   // 6
{
    return ClothFootprint(in2(k), in2(k + 2), in2(k + 4), ivec2(0, 0));
}

CLOTH_FN ClothLight in_light(int k)   // 19
{
    return ClothLight(in_int(k), in1(k + 1), in3(k + 2), in3(k + 5), in3(k + 8), in3(k + 11), in3(k + 14), in2(k + 17));
}

CLOTH_FN ClothEmitter in_emitter(int k)   // 13
{
    return ClothEmitter(in3(k), in3(k + 3), in3(k + 6), in_word(k + 9), in_word(k + 11));
}

CLOTH_FN void out_frame(int k, ClothFrame frame)   // 9
{
    out3(k, frame.x);
    out3(k + 3, frame.y);
    out3(k + 6, frame.z);
}

CLOTH_FN void out_light(int k, ClothLightSample s)   // 8
{
    out3(k, s.wi);
    out1(k + 3, s.distance);
    out3(k + 4, s.radiance);
    out1(k + 7, s.pdf);
}

CLOTH_FN void out_texel(int k, ClothTexel t)   // 16
{
    out3(k, t.point.normal_f);
    out3(k + 3, t.point.normal_b);
    out3(k + 6, t.point.tangent);
    out1(k + 9, t.point.length_f);
    out1(k + 10, t.point.length_b);
    out2(k + 11, t.slope_f);
    out1(k + 13, real(t.yarn));
    out1(k + 14, t.gap ? real(1) : real(0));
    out1(k + 15, t.openness_f);
}
