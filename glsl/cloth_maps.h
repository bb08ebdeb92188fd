// Packed maps of a fabric's repeat -> the point that the BSDF and the visibility see. The words are those of bake/pack.hpp.
// Shared; imports cloth_bsdf.h, cloth_visibility.h, cloth_fetch.h. side: 0 front, 1 back.

CLOTH_CONST real cloth_slope_max  = real(4);   // slopes are stored in [-4, 4] [math.md 10, hazard 2]
CLOTH_CONST real cloth_height_top = real(65535);

// A texel of both sides, decoded.
struct ClothTexel {
    ClothPoint point;      // tangent already turned by the fibre twist
    real2 slope_f;
    int yarn;              // yarn type; that of the nearest yarn in a gap
    bool gap;
    real openness_f;       // I_p, cosine irradiance of the front [8.1]
    real openness_b;
    uvec2 back;            // its word of the other side
};

CLOTH_FN real2 cloth_decode_slopes(uint word)
{
    int x = int(word << 16u) >> 16;
    int y = int(word) >> 16;
    return real2(real(x), real(y)) * (cloth_slope_max / real(32767));
}

// A spot is a place in the repeat, in quarters of a texel: xy of its texel is spot >> 2. Of a position in tiles, any finite one.
CLOTH_FN ivec2 cloth_spot_at(CLOTH_IN(ClothMaps) maps, real2 tile)
{
    real2 f    = tile - floor(tile);
    ivec2 size = maps.size * 4;
    return ivec2(min(int(f.x * real(size.x)), size.x - 1), min(int(f.y * real(size.y)), size.y - 1));
}

CLOTH_FN ivec2 cloth_texel_at(CLOTH_IN(ClothMaps) maps, real2 tile)   // nearest texel
{
    return cloth_spot_at(maps, tile) >> 2;
}

CLOTH_FN bool cloth_texel_is_gap(uvec2 word)
{
    return (word.y & 0x800000u) != 0u;
}

CLOTH_FN int cloth_texel_yarn(uvec2 word)
{
    return int((word.y >> 16u) & 127u);
}

// Fibre twist at a texel: that of the yarn, plus the noise N(p) of the place on the cloth [math.md 1].
//   twist, return  cosine and sine;  tile  index of the repeat, any integers
CLOTH_FN real2 cloth_twist(CLOTH_IN(ClothMaps) maps, real2 twist, ivec2 xy, ivec2 tile)
{
    if (maps.noise_amplitude <= real(0)) return twist;
    real2 cells = real2((real(xy.x) + real(0.5)) / real(maps.size.x) * real(maps.noise_cells.x),
                        (real(xy.y) + real(0.5)) / real(maps.size.y) * real(maps.noise_cells.y));
    real2 base  = floor(cells);
    uvec2 cell  = uvec2(uint(tile.x) * uint(maps.noise_cells.x) + uint(base.x), uint(tile.y) * uint(maps.noise_cells.y) + uint(base.y));
    real more   = maps.noise_amplitude / cloth_noise_mean_abs * cloth_noise(cell, cells - base);
    real c = cos(more), s = sin(more);
    return real2(twist.x * c - twist.y * s, twist.y * c + twist.x * s);
}

// Length of the area vector (-slope, 1), and its direction; `area` is that length.
CLOTH_FN real cloth_area_length(real2 slope)
{
    return sqrt(real(1) + dot(slope, slope));
}

CLOTH_FN real3 cloth_slope_normal(real2 slope, real area)
{
    return real3(-slope.x, -slope.y, real(1)) * (real(1) / area);
}

// Fibres on the surface of a ply: its way in the plane, lifted onto the surface, and turned by the twist.
//   word, slope, normal  of the texel, from its side;  noise  false: without N(p)
CLOTH_FN real3 cloth_fibre_tangent(CLOTH_IN(ClothMaps) maps, int side, uvec2 word, real2 slope, real3 normal, ivec2 xy, ivec2 tile, bool noise)
{
    real azimuth = real(word.y & 0xffffu) * (cloth_pi / real(65536));
    real cx = cos(azimuth), cy = sin(azimuth);
    real rise   = slope.x * cx + slope.y * cy;
    real3 ply   = real3(cx, cy, rise) * (real(1) / sqrt(real(1) + rise * rise));   // perpendicular to the normal by construction
    real2 twist = cloth_fetch_yarn(maps, cloth_texel_yarn(word)).twist;
    if (noise) twist = cloth_twist(maps, twist, xy, tile);
    // The mirror of the back side turns the sense of a twist around [math.md 1].
    return twist.x * ply + (side == 0 ? twist.y : -twist.y) * cross(normal, ply);
}

// Both sides of texel xy of repeat `tile` as seen from `side`: "front" below is the viewer's side.
CLOTH_FN ClothTexel cloth_texel(CLOTH_IN(ClothMaps) maps, int side, ivec2 xy, ivec2 tile, bool noise)
{
    uvec4 both   = cloth_fetch_texels(maps, side, xy);
    uvec2 front  = uvec2(both.x, both.y), back = uvec2(both.z, both.w);
    real2 s_f    = cloth_decode_slopes(front.x);
    real2 s_b    = cloth_decode_slopes(back.x);
    real len_f   = cloth_area_length(s_f);
    real len_b   = cloth_area_length(s_b);
    real3 n_f    = cloth_slope_normal(s_f, len_f);
    real3 t      = cloth_fibre_tangent(maps, side, front, s_f, n_f, xy, tile, noise);
    return ClothTexel(ClothPoint(n_f, cloth_slope_normal(s_b, len_b), t, t, len_f, len_b), s_f, cloth_texel_yarn(front), cloth_texel_is_gap(front),
                      real(front.y >> 24u) / real(255), real(back.y >> 24u) / real(255), back);
}

// Half-resolution texel along one axis whose horizons a spot sees: its own, or from the outermost quarter of a texel the next
// one. All quarters of a texel together are the bilinear filter between half-resolution texels [8.5], at one fetch in place of
// four; where in its texel a ray arrives is random.
CLOTH_FN int cloth_horizon_cell(int spot, int size)
{
    int cell = (spot - 1 + ((spot >> 1) & 2)) >> 3;   // its own half of the half-resolution texel does not lead out of it
    return cell < 0 ? size - 1 : cell < size ? cell : 0;
}

CLOTH_FN ivec2 cloth_horizon_at(CLOTH_IN(ClothMaps) maps, ivec2 spot)
{
    return ivec2(cloth_horizon_cell(spot.x, maps.size.x >> 1), cloth_horizon_cell(spot.y, maps.size.y >> 1));
}

#ifdef __cplusplus
// Have what the maps say brought from memory, for those who will ask soon and have other work first. Inlined by force: GCC takes
// a call that only prefetches for one without effects.
[[gnu::always_inline]] inline void cloth_prefetch_texels(const ClothMaps& maps, ivec2 spot)   // of both sides
{
    int index = (spot.y >> 2) * maps.size.x + (spot.x >> 2);
    for (int side = 0; side < 2; ++side) __builtin_prefetch(maps.texels[side] + index);
}
[[gnu::always_inline]] inline void cloth_prefetch_horizons(const ClothMaps& maps, ivec2 spot)   // likewise
{
    ivec2 cell = cloth_horizon_at(maps, spot);
    int index  = cell.y * (maps.size.x / 2) + cell.x;
    for (int side = 0; side < 2; ++side)
        if (maps.horizons[side]) __builtin_prefetch(maps.horizons[side] + index);
}
[[gnu::always_inline]] inline void cloth_prefetch_height(const ClothMaps& maps, int side, uvec2 place)
{
    ivec2 xy = ivec2(((place >> 16u) * uvec2(maps.size)) >> 16u);
    __builtin_prefetch(maps.heights[side] + xy.y * maps.size.x + xy.x);
}
#endif

// V from 16 knots: as cloth_horizon_visibility, with knots at multiples of 22.5 degrees, which lie half way between its own.
CLOTH_FN real cloth_horizon16_visibility(CLOTH_IN(ClothMaps) maps, int side, ivec2 spot, real3 d)
{
    if (d.z <= real(0)) return real(0);
    real g     = real(2) * cloth_horizon_azimuth(real2(d.x, d.y));
    real k     = floor(g);
    uint k0    = uint(k) & 15u;
    uint k1    = (k0 + 1u) & 15u;
    ivec2 cell = cloth_horizon_at(maps, spot);
    int index  = 2 * (cell.y * (maps.size.x / 2) + cell.x);
    real s     = mix(cloth_horizon_knot(cloth_fetch_visibility(maps, side, index + int(k0 >> 3u)), k0 & 7u),
                     cloth_horizon_knot(cloth_fetch_visibility(maps, side, index + int(k1 >> 3u)), k1 & 7u), g - k);
    return cloth_horizon_step(s / real(255), d.z);
}

// V from the heights themselves: the ray from the middle of a texel meets the relief or not. Every line of texels that it
// crosses, heights interpolated along the line, until it is above all of them or has gone as far as cloth_exact_reach. The
// slow truth that the other kinds stand for.
CLOTH_CONST real cloth_exact_reach = real(16);      // height ranges, and at least the tile: beyond, horizons are below 3.6 degrees
CLOTH_CONST real cloth_exact_steps = real(16384);   // and never more
CLOTH_FN real cloth_exact_visibility(CLOTH_IN(ClothMaps) maps, int side, ivec2 xy, real3 d)
{
    if (d.z <= real(0)) return real(0);
    real range  = side == 0 ? maps.height_high.x - maps.height_low.x : maps.height_high.y - maps.height_low.y;
    real2 way   = real2(d.x * real(maps.size.x) / maps.tile_m.x, d.y * real(maps.size.y) / maps.tile_m.y);   // texels a metre
    bool along  = abs(way.x) >= abs(way.y);
    real major  = along ? way.x : way.y;
    if (abs(major) <= real(1e-6) * real(max(maps.size.x, maps.size.y)) * d.z / max(range, real(1e-9))) return real(1);   // straight up
    real minor  = (along ? way.y : way.x) / abs(major);
    real rise   = max(d.z / abs(major) / range * cloth_height_top, real(1e-6));   // units of the map a step
    real from   = real(cloth_fetch_height(maps, side, xy));
    real reach  = max(max(maps.tile_m.x, maps.tile_m.y), cloth_exact_reach * range) * abs(major) / sqrt(max(d.x * d.x + d.y * d.y, real(1e-12)));
    int last    = int(ceil(min((cloth_height_top - from) / rise, min(reach, cloth_exact_steps))));
    int count   = along ? maps.size.x : maps.size.y, across = along ? maps.size.y : maps.size.x;
    int way_on  = major < real(0) ? count - 1 : 1;
    int at      = along ? xy.x : xy.y;
    for (int k = 1; k <= last; ++k) {
        at = (at + way_on) % count;
        real row  = real(along ? xy.y : xy.x) + real(k) * minor;
        real base = floor(row);
        int low   = int(base - real(across) * floor(base / real(across)));   // GLSL has no remainder of negative numbers
        low       = low >= across ? 0 : low;
        int high  = low + 1 == across ? 0 : low + 1;
        real a    = real(cloth_fetch_height(maps, side, along ? ivec2(at, low) : ivec2(low, at)));
        real b    = real(cloth_fetch_height(maps, side, along ? ivec2(at, high) : ivec2(high, at)));
        if (mix(a, b, row - base) > from + real(k) * rise) return real(0);
    }
    return real(1);
}

// A position in tiles, any finite one, as 32-bit fractions of the repeat's sides, which wrap by themselves.
CLOTH_FN uvec2 cloth_wrap(real2 tile)
{
    real2 f = tile - floor(tile);
    return uvec2(uint(int(f.x * real(16777216))) << 8u, uint(int(f.y * real(16777216))) << 8u);
}

// Height at such a place, in units of the map: 0 lowest, cloth_height_top highest; flat within a texel.
CLOTH_FN real cloth_height_at(CLOTH_IN(ClothMaps) maps, int side, uvec2 place)
{
    return real(cloth_fetch_height(maps, side, ivec2(((place >> 16u) * uvec2(maps.size)) >> 16u)));
}

// Mean slopes (sx, sy) of the 2^level block around a position in tiles; level 0 is the texel, the last level the tile [7].
CLOTH_FN real2 cloth_mean_slopes(CLOTH_IN(ClothMaps) maps, int side, real2 tile, int level)
{
    ivec2 size = maps.size;
    if (level <= 0) return cloth_decode_slopes(cloth_fetch_texels(maps, side, cloth_texel_at(maps, tile)).x);
    int offset = 0;
    for (int l = 1; l < level && (size.x > 3 || size.y > 3); ++l) {
        size = ivec2(max(size.x / 2, 1), max(size.y / 2, 1));
        offset += size.x * size.y;
    }
    size    = ivec2(max(size.x / 2, 1), max(size.y / 2, 1));
    real2 f = tile - floor(tile);
    int x   = min(int(f.x * real(size.x)), size.x - 1);
    int y   = min(int(f.y * real(size.y)), size.y - 1);
    return cloth_decode_slopes(cloth_fetch_slope_mip(maps, side, offset + y * size.x + x));
}
