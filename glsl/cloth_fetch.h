// The one door through which shared code reads memory: arrays in C++, buffers and textures in GLSL. Imports cloth_types.h.
//   cloth_fetch_texels     those of both sides, that of `side` (0 front, 1 back) in xy; xy in [0, size)
//   cloth_fetch_horizons   likewise; xy in [0, size / 2)
//   cloth_fetch_visibility  word of the horizons, or of what takes their place: two a half-resolution texel for 16 knots, one a
//                          texel for caps
//   cloth_fetch_height     xy in [0, size); 16 bits, 0 at height_low, 65535 at height_high
//   cloth_fetch_asg        two records of four numbers a texel: (mu.xyz, gamma), (sigma_x, sigma_y, amplitude, 0)
//   cloth_fetch_slope_mip  index into the concatenated mip levels 1, 2, ...
//   cloth_fetch_environment  rgb radiance, w density over UV (mean 1)
//   cloth_fetch_emitter    triangle of a shining object
//   cloth_fetch_inversion  of the environment: the texels of each row, then the rows. x where the share of the texels up to this
//                          one ends, as a 32-bit fraction; y where to begin to look in this part of the fractions

#ifdef __cplusplus

struct ClothMaps {
    ivec2 size = ivec2(0, 0);   // texels of the repeat
    const glm::uvec2* texels[2]   = {nullptr, nullptr};
    const glm::uvec2* horizons[2] = {nullptr, nullptr};
    const glm::uint* mips[2]      = {nullptr, nullptr};
    const std::uint16_t* heights[2] = {nullptr, nullptr};
    const real4* asg[2]           = {nullptr, nullptr};   // only where the visibility is of that kind
    const ClothYarn* yarns        = nullptr;
    real2 tile_m = real2(1, 1);             // size of the repeat [m]
    real2 height_low  = real2(0, 0);        // of front and back [m]
    real2 height_high = real2(0, 0);
    ivec2 noise_cells = ivec2(1, 1);        // of the twist noise, per repeat
    real noise_amplitude = 0;               // mean |N| [rad], 0: none
};

struct ClothLights {
    int count = 0;
    ivec2 environment_size       = ivec2(0, 0);
    const ClothLight* lights     = nullptr;
    const real4* environment     = nullptr;
    const glm::uvec2* inversion  = nullptr;
    const ClothEmitter* emitters = nullptr;
};

inline uvec4 cloth_fetch_texels(const ClothMaps& maps, int side, ivec2 xy)
{
    int index = xy.y * maps.size.x + xy.x;
    return uvec4(maps.texels[side][index], maps.texels[1 - side][index]);
}
inline uvec4 cloth_fetch_horizons(const ClothMaps& maps, int side, ivec2 xy)
{
    int index = xy.y * (maps.size.x >> 1) + xy.x;
    return uvec4(maps.horizons[side][index], maps.horizons[1 - side][index]);
}
inline uvec2 cloth_fetch_visibility(const ClothMaps& maps, int side, int index)
{
    return maps.horizons[side][index];
}
inline uint cloth_fetch_slope_mip(const ClothMaps& maps, int side, int index)
{
    return maps.mips[side][index];
}
inline uint cloth_fetch_height(const ClothMaps& maps, int side, ivec2 xy)
{
    return maps.heights[side][xy.y * maps.size.x + xy.x];
}
inline real4 cloth_fetch_asg(const ClothMaps& maps, int side, ivec2 xy, int record)
{
    return maps.asg[side][(xy.y * maps.size.x + xy.x) * 2 + record];
}
inline ClothYarn cloth_fetch_yarn(const ClothMaps& maps, int index)
{
    return maps.yarns[index];
}
inline ClothLight cloth_fetch_light(const ClothLights& lights, int index)
{
    return lights.lights[index];
}
inline real4 cloth_fetch_environment(const ClothLights& lights, ivec2 xy)
{
    return lights.environment[xy.y * lights.environment_size.x + xy.x];
}
inline uvec2 cloth_fetch_inversion(const ClothLights& lights, int index)
{
    return lights.inversion[index];
}
inline ClothEmitter cloth_fetch_emitter(const ClothLights& lights, int index)
{
    return lights.emitters[index];
}

#else

uniform usamplerBuffer map_words;      // RGBA32UI: texels and horizons of all fabrics, front xy, back zw
uniform usamplerBuffer slope_words;    // R32UI: slope mips of all fabrics
uniform usamplerBuffer height_words;   // R16UI: heights of all fabrics
uniform samplerBuffer asg_table;       // RGBA32F, two records a texel
uniform samplerBuffer yarn_table;      // RGBA32F, seven texels a yarn type
uniform samplerBuffer light_table;     // RGBA32F, six texels a light
uniform sampler2D environment_map;     // RGBA32F
uniform usampler2D inversion_map;      // RG32UI, as wide as the environment
uniform usamplerBuffer emitter_table;  // RGBA32UI, three texels a triangle

struct ClothMaps {
    ivec2 size;
    int texels;        // first in map_words
    int horizons;      // likewise
    ivec2 mips;        // of front and back in slope_words
    int heights;       // first of the front's in height_words; the back's follow
    int asg;           // likewise in asg_table
    int yarns;         // first yarn type in yarn_table
    vec2 tile_m;
    vec2 height_low;   // of front and back [m]
    vec2 height_high;
    ivec2 noise_cells;
    float noise_amplitude;
};

struct ClothLights {
    int count;
    ivec2 environment_size;
};

uvec4 cloth_fetch_texels(ClothMaps maps, int side, ivec2 xy)
{
    uvec4 both = texelFetch(map_words, maps.texels + xy.y * maps.size.x + xy.x);
    return side == 0 ? both : both.zwxy;
}
uvec4 cloth_fetch_horizons(ClothMaps maps, int side, ivec2 xy)
{
    uvec4 both = texelFetch(map_words, maps.horizons + xy.y * (maps.size.x >> 1) + xy.x);
    return side == 0 ? both : both.zwxy;
}
uvec2 cloth_fetch_visibility(ClothMaps maps, int side, int index)
{
    uvec4 both = texelFetch(map_words, maps.horizons + index);
    return side == 0 ? both.xy : both.zw;
}
uint cloth_fetch_slope_mip(ClothMaps maps, int side, int index)
{
    return texelFetch(slope_words, (side == 0 ? maps.mips.x : maps.mips.y) + index).x;
}
uint cloth_fetch_height(ClothMaps maps, int side, ivec2 xy)
{
    return texelFetch(height_words, maps.heights + ((side == 0 ? 0 : maps.size.y) + xy.y) * maps.size.x + xy.x).x;
}
vec4 cloth_fetch_asg(ClothMaps maps, int side, ivec2 xy, int record)
{
    return texelFetch(asg_table, maps.asg + (((side == 0 ? 0 : maps.size.y) + xy.y) * maps.size.x + xy.x) * 2 + record);
}
// In the first texel is all that a straight way through a yarn asks for.
ClothYarn cloth_fetch_yarn(ClothMaps maps, int index)
{
    int base = (maps.yarns + index) * 7;
    vec4 a = texelFetch(yarn_table, base), b = texelFetch(yarn_table, base + 1), c = texelFetch(yarn_table, base + 2);
    vec4 d = texelFetch(yarn_table, base + 3), e = texelFetch(yarn_table, base + 4), f = texelFetch(yarn_table, base + 5);
    vec4 g = texelFetch(yarn_table, base + 6);
    vec2 twist = vec2(1.0 - a.w * a.w, 2.0 * a.w) * (1.0 / (1.0 + a.w * a.w));   // from the tangent of half the angle
    return ClothYarn(b.xyz, c.xyz, d.xyz, e.xyz, b.w, a.x, a.y, twist, c.w, f.xyz, vec3(d.w, e.w, f.w), g.xyz, a.z, a.y);
}
ClothLight cloth_fetch_light(ClothLights lights, int index)
{
    int base = index * 6;
    vec4 a = texelFetch(light_table, base), b = texelFetch(light_table, base + 1), c = texelFetch(light_table, base + 2);
    vec4 d = texelFetch(light_table, base + 3), e = texelFetch(light_table, base + 4), f = texelFetch(light_table, base + 5);
    return ClothLight(int(f.x), f.y, a.xyz, b.xyz, c.xyz, d.xyz, e.xyz, vec2(a.w, b.w));
}
vec4 cloth_fetch_environment(ClothLights lights, ivec2 xy)
{
    return texelFetch(environment_map, xy, 0);
}
uvec2 cloth_fetch_inversion(ClothLights lights, int index)
{
    return texelFetch(inversion_map, ivec2(index % lights.environment_size.x, index / lights.environment_size.x), 0).xy;
}
ClothEmitter cloth_fetch_emitter(ClothLights lights, int index)
{
    uvec4 a = texelFetch(emitter_table, index * 3), b = texelFetch(emitter_table, index * 3 + 1), c = texelFetch(emitter_table, index * 3 + 2);
    return ClothEmitter(uintBitsToFloat(a.xyz), uintBitsToFloat(b.xyz), uintBitsToFloat(c.xyz), a.w, b.w);
}

#endif
