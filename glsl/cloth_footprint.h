// Which point of the cloth a ray sees inside its footprint, and how much light crosses the cloth [math.md 5.2, 6].
// Shared; imports cloth_maps.h, random.h.

// What is evaluated: every ingredient of the model by itself. The programs' --mode, --bsdf and --visibility set several.
CLOTH_CONST int cloth_bsdf_micro = 0;       // ply-level BSDF at uniform points of the footprint: Jin et al. 2022 plus transmission
CLOTH_CONST int cloth_bsdf_meso  = 1;       // with shadowing and masking
CLOTH_CONST int cloth_weight_relief   = 0;  // the view ray is followed down to the point it meets [6.4.1]
CLOTH_CONST int cloth_weight_resample = 1;  // one of four candidates in proportion to its visible area [6.4.2]
CLOTH_CONST int cloth_weight_mips     = 2;  // A_p / A_G with A_G from the mean slopes: the paper [6.1]
CLOTH_CONST int cloth_weight_tile     = 3;  // A_p / A_G with A_G = o.z: right for footprints of a repeat and more [6.2]
CLOTH_CONST int cloth_visibility_none     = 0;
CLOTH_CONST int cloth_visibility_horizon8 = 1;
CLOTH_CONST int cloth_visibility_asg      = 2;
CLOTH_CONST int cloth_visibility_horizon16 = 3;
CLOTH_CONST int cloth_visibility_cap       = 4;
CLOTH_CONST int cloth_visibility_exact     = 5;

struct ClothSettings {
    int bsdf;
    int weight;
    int visibility;
    int slab;              // cloth_slab_ply or cloth_slab_macro
    bool unscattered;      // light that crosses a yarn without meeting a fibre [3.1, 5.2]
    bool interreflection;  // between yarns [9.1]
    bool twist_noise;
};

// Candidates of the resampling: bias 1.1 % at four [6.4.2]; stratified here, which only lowers it.
CLOTH_CONST int cloth_candidates = 4;
CLOTH_CONST real cloth_area_min  = real(0.02);   // floor of A_G in the paper's form [6.2]
// The march of the view ray: its step, so that no ply (10 texels and more) is stepped over, and the most steps: longer ways
// get longer ones. Finer than by steps of 2 texels the place need not be known: with those of 3 and two halvings close-ups were no nearer
// to the truth (both within 1.5 % at 75 and 85 degrees on plain, twill, satin and wool_rib), and each look-up waits for the last.
CLOTH_CONST real cloth_march_step = real(2);   // [texels]
CLOTH_CONST int cloth_march_steps = 256;

// Where a ray meets the cloth, in tiles of the fabric: centre and extent of one pixel step.
struct ClothFootprint {
    real2 tile;     // position, less `base`
    real2 dx;       // change per pixel step in x
    real2 dy;
    ivec2 base;     // whole repeats
};

// A chosen point. `weight` multiplies cloth_point_value.
struct ClothSelection {
    bool passes;            // the ray goes straight through; nothing else is meaningful then
    real weight;
    ClothTexel texel;
    ClothYarn yarn;
    int side;               // the viewer's
    ivec2 spot;             // in quarters of a texel
    ivec2 repeat;           // with twist noise
    uvec4 horizons;         // of the spot, the viewer's side xy; 0 for other kinds of visibility
    real u;                 // [0, 1), which says which of two yarns over each other bends light
};

// Where in the cloth a ray's point lies: what is found by looking at the maps, small enough to be handed from pass to pass.
struct ClothPlace {
    ivec2 spot;    // in quarters of a texel
    ivec2 repeat;  // which repeat, counted from the footprint's base
    real area;     // A_p, where the weight is made of areas; 0: nothing visible was found
};

CLOTH_FN bool cloth_uses_visibility(ClothSettings settings)
{
    return settings.bsdf == cloth_bsdf_meso && settings.visibility != cloth_visibility_none;
}

// The kinds of visibility that are not the default.
CLOTH_RARE_FN real cloth_other_visibility_at(CLOTH_IN(ClothMaps) maps, int side, ivec2 spot, real3 d, int kind)
{
    if (kind == cloth_visibility_horizon16) return cloth_horizon16_visibility(maps, side, spot, d);
    ivec2 xy = spot >> 2;
    if (kind == cloth_visibility_asg)
        return cloth_asg_visibility(cloth_fetch_asg(maps, side, xy, 0), cloth_fetch_asg(maps, side, xy, 1), d);
    if (kind == cloth_visibility_cap)
        return cloth_cap_visibility(cloth_fetch_visibility(maps, side, xy.y * maps.size.x + xy.x), d);
    return cloth_exact_visibility(maps, side, xy, d);
}

// V of a direction at a spot, in the frame of `side`.
CLOTH_FN real cloth_visibility_at(CLOTH_IN(ClothMaps) maps, int side, ivec2 spot, real3 d, ClothSettings settings)
{
    if (!cloth_uses_visibility(settings)) return d.z > real(0) ? real(1) : real(0);
    if (settings.visibility != cloth_visibility_horizon8) return cloth_other_visibility_at(maps, side, spot, d, settings.visibility);
    uvec4 both = cloth_fetch_horizons(maps, side, cloth_horizon_at(maps, spot));
    return cloth_horizon_visibility(uvec2(both.x, both.y), d);
}

// The horizons that a spot sees, those of `side` first.
CLOTH_FN uvec4 cloth_spot_horizons(CLOTH_IN(ClothMaps) maps, int side, ivec2 spot, ClothSettings settings)
{
    if (!cloth_uses_visibility(settings) || settings.visibility != cloth_visibility_horizon8) return uvec4(0u);
    return cloth_fetch_horizons(maps, side, cloth_horizon_at(maps, spot));
}

// V of a direction at a chosen point.
//   beyond  on the side away from the viewer;  d  in the frame of that side
CLOTH_FN real cloth_selection_visibility(CLOTH_IN(ClothMaps) maps, CLOTH_IN(ClothSelection) selection, bool beyond, real3 d, ClothSettings settings)
{
    if (!cloth_uses_visibility(settings)) return d.z > real(0) ? real(1) : real(0);
    if (settings.visibility != cloth_visibility_horizon8)
        return cloth_other_visibility_at(maps, beyond ? 1 - selection.side : selection.side, selection.spot, d, settings.visibility);
    uvec4 both = selection.horizons;
    return cloth_horizon_visibility(beyond ? uvec2(both.z, both.w) : uvec2(both.x, both.y), d);
}

// A_G of the paper: projected area of the footprint from the mean slopes of the mip level that matches it [6.2, 7].
CLOTH_FN real cloth_area_from_mips(CLOTH_IN(ClothMaps) maps, int side, ClothFootprint footprint, real3 o)
{
    real area  = abs(footprint.dx.x * footprint.dy.y - footprint.dx.y * footprint.dy.x) * real(maps.size.x) * real(maps.size.y);
    int level  = int(clamp(floor(real(0.5) * log2(max(area, real(1))) + real(0.5)), real(0), real(31)));
    real2 mean = cloth_mean_slopes(maps, side, footprint.tile, level);
    return max(o.z - dot(mean, real2(o.x, o.y)), cloth_area_min);
}

// A view ray on its way down through the relief: steps in z, from which its place in the repeat follows.
struct ClothDescent {
    real2 start;     // the ray is at `start` + `run` z, in tiles
    real2 run;
    real step;       // in z: no more than cloth_march_steps of them lead to the lowest height
    real z;          // of the first place, in units of the map, 0 at the lowest height
    uvec2 place;
    uvec2 down;      // a step
};

CLOTH_FN ClothDescent cloth_descent(CLOTH_IN(ClothMaps) maps, int side, real2 tile, real3 o, real u)
{
    real low  = side == 0 ? maps.height_low.x : maps.height_low.y;
    real high = side == 0 ? maps.height_high.x : maps.height_high.y;
    real2 way   = real2(o.x, o.y) / (o.z * maps.tile_m);   // per metre of height
    real2 start = tile + way * low;
    real2 all   = way * (high - low);
    real2 run   = all * (real(1) / cloth_height_top);
    real texels = max(abs(all.x) * real(maps.size.x), abs(all.y) * real(maps.size.y));
    real count  = floor(min(texels * (real(1) / cloth_march_step), real(cloth_march_steps - 1))) + real(1);
    real step   = cloth_height_top / count;
    real z      = cloth_height_top - step * u;   // the first step ends in the relief
    return ClothDescent(start, run, step, z, cloth_wrap(start + run * z), cloth_wrap(run * -step));
}

// Where it meets the relief, in tiles.
CLOTH_FN real2 cloth_descend(CLOTH_IN(ClothMaps) maps, int side, ClothDescent ray)
{
    real z      = ray.z;
    uvec2 place = ray.place;
    while (cloth_height_at(maps, side, place) < z) {   // which no height is below 0
        z -= ray.step;
        place += ray.down;
    }
    // The surface lies between z and a step above it: half way, for of a wall between two texels each gets its half. Below, crests
    // would be seen too often.
    return ray.start + ray.run * (z + real(0.5) * ray.step);
}

// First point of the height field that the view ray through `tile` on the mid-plane meets, in tiles [6.4.1]. The field is one
// of flat texels: the caller moves `tile` by up to half a texel each way, which makes it bilinear in the mean.
//   u  in [0, 1) shifts the steps, so that what a step can miss averages out
CLOTH_FN real2 cloth_march(CLOTH_IN(ClothMaps) maps, int side, real2 tile, real3 o, real u)
{
    return cloth_descend(maps, side, cloth_descent(maps, side, tile, o, u));
}

// A uniform point of the footprint, in tiles.
CLOTH_FN real2 cloth_footprint_tile(CLOTH_IN(ClothMaps) maps, ClothFootprint footprint, ClothRandom random)
{
    real2 xi = cloth_draw(random, cloth_dim_footprint) - real2(real(0.5));
    // Moving by up to half a texel each way before the nearest fetch is a bilinear filter in the mean.
    real2 half_texel = (cloth_draw(random, cloth_dim_texel) - real2(real(0.5))) / real2(real(maps.size.x), real(maps.size.y));
    return footprint.tile + footprint.dx * xi.x + footprint.dy * xi.y + half_texel;
}

// Whether points are weighted by their areas, or the one that the relief shows is found.
CLOTH_FN bool cloth_weighs_areas(ClothSettings settings)
{
    return settings.bsdf == cloth_bsdf_meso && settings.weight != cloth_weight_relief;
}

CLOTH_FN bool cloth_follows_relief(ClothSettings settings)
{
    return settings.bsdf == cloth_bsdf_meso && settings.weight == cloth_weight_relief;
}

CLOTH_FN ClothPlace cloth_place_at(CLOTH_IN(ClothMaps) maps, real2 tile, real area)
{
    real2 base = floor(tile);
    return ClothPlace(cloth_spot_at(maps, tile), ivec2(int(base.x), int(base.y)), area);
}

// The point that the ray sees.
//   side    0 front, 1 back;  o  local direction to the viewer, o.z > 0;  u  cloth_dim_pick, x
CLOTH_FN ClothPlace cloth_find(CLOTH_IN(ClothMaps) maps, int side, ClothFootprint footprint, real3 o, ClothSettings settings,
                               ClothRandom random, real u)
{
    real2 chosen = cloth_footprint_tile(maps, footprint, random);
    real area    = real(1);
    if (cloth_follows_relief(settings)) {
        chosen = cloth_march(maps, side, chosen, o, u);
    } else if (cloth_weighs_areas(settings)) {
        bool resample     = settings.weight == cloth_weight_resample;
        real2 u_footprint = cloth_draw(random, cloth_dim_footprint);
        real2 first    = chosen;
        int candidates = resample ? cloth_candidates : 1;
        real total     = real(0);
        area           = real(0);
        // If every candidate is masked the draw is repeated, up to three rounds; then the last one is taken.
        for (int j = 0; j < candidates * 3; ++j) {
            // Additive recurrence R2 (Roberts 2018): every candidate is uniform, together they are spread over the footprint.
            real2 shift = real2(real(j) * real(0.7548776662466927), real(j) * real(0.5698402909980532));
            real2 away  = u_footprint + shift;
            away        = away - floor(away) - u_footprint;   // from the first candidate
            real2 tile  = first + footprint.dx * away.x + footprint.dy * away.y;
            ivec2 spot  = cloth_spot_at(maps, tile);
            real2 slope = cloth_decode_slopes(cloth_fetch_texels(maps, side, spot >> 2).x);
            real a      = max(o.z - dot(slope, real2(o.x, o.y)), real(0));
            if (a > real(0)) a *= cloth_visibility_at(maps, side, spot, o, settings);
            total += a;
            // Reservoir of one: keep candidate j with probability a / total; u is stretched to be uniform again.
            real keep = total > real(0) ? a / total : real(0);
            bool take = u < keep || j == 0;
            if (a > real(0)) u = u < keep ? u / keep : (u - keep) / max(real(1) - keep, real(1e-6));
            if (take) {
                chosen = tile;
                area   = a;
            }
            if (j + 1 >= candidates && (total > real(0) || !resample)) break;
        }
    }
    return cloth_place_at(maps, chosen, area);
}

// Share of a straight way that goes on where one yarn more may be in its way: past it, or through it as through the one here.
//   v  visibility;  unscattered  the yarn's share U
CLOTH_FN real cloth_clears(real v, real unscattered)
{
    return v + (real(1) - v) * unscattered;
}

// A shader that is told that no yarn lies over another (CLOTH_STACKS 0) has no code for it.
#ifndef CLOTH_STACKS
#define CLOTH_STACKS 1
#endif

// Whether the ray passes a found point, and what it meets there: all but which yarn bends light (cloth_stack).
//   u       cloth_dim_pick, y
//   stops   true where the ray is known to stop here: what hides the light behind need not be looked up again
CLOTH_FN ClothSelection cloth_reach(CLOTH_IN(ClothMaps) maps, int side, ClothFootprint footprint, ClothPlace place, real3 o,
                                   ClothSettings settings, real u, bool stops)
{
    bool meso     = settings.bsdf == cloth_bsdf_meso;
    bool relief   = cloth_follows_relief(settings);
    bool resample = meso && settings.weight == cloth_weight_resample;

    ClothSelection result;
    result.passes   = false;
    result.weight   = real(1);
    result.side     = side;
    result.spot     = place.spot;
    result.horizons = cloth_spot_horizons(maps, side, place.spot, settings);   // once, for all that ask
    result.repeat   = settings.twist_noise ? footprint.base + place.repeat : ivec2(0, 0);
    result.texel    = cloth_texel(maps, side, place.spot >> 2, result.repeat, settings.twist_noise);
    result.yarn   = cloth_fetch_yarn(maps, result.texel.yarn);
    if (meso && settings.weight == cloth_weight_mips) result.weight = place.area / cloth_area_from_mips(maps, side, footprint, o);
    if (meso && settings.weight == cloth_weight_tile) result.weight = place.area / o.z;

    // A point that turns out to face away (filtered slopes under the march, or nothing visible found) is seen as a flat one.
    if ((relief && dot(result.texel.point.normal_f, o) <= real(1e-3) * o.z) || (resample && place.area <= real(0))) {
        result.texel.point.normal_f = real3(real(0), real(0), real(1));
        result.texel.point.length_f = real(1);
    }
    // Straight through a gap if the line clears the yarns behind as well. A gap point that does not is the flank of its
    // nearest yarn, shaded with n_s [5.2]; the paper has no flank. Through a yarn goes what meets no fibre. A weight other
    // than 1 is spent as a probability, which saturates above 1: it cannot be carried to the next layer.
    real unscattered = settings.unscattered ? cloth_unscattered(result.yarn, result.texel.point.normal_f, result.texel.point.tangent, o) : real(0);
    real through     = (result.texel.gap ? real(1) : unscattered) * min(result.weight, real(1));
    result.passes    = !stops && u < through;
    if (result.passes && meso) {
        real v        = cloth_selection_visibility(maps, result, true, real3(-o.x, -o.y, o.z), settings);
        result.passes = u < through * cloth_clears(v, unscattered);
    }
    if (result.texel.gap && !result.passes && !relief && !resample && meso) result.weight = real(0);
    // The slab's albedo leaves out what goes straight through: a yarn that is shaded stands for those draws as well, and one
    // whose straight way ends at the yarns behind is dark.
    if (!result.texel.gap && !result.passes)
        result.weight = u < through ? real(0) : result.weight / max(real(1) - through, real(1e-3));
    result.u = (u - through) / max(real(1) - through, real(1e-3));   // of u that decided so far, what is left is uniform
    return result;
}

// Of two yarns over each other either one bends what the other lets pass [model.md]: one of the two is drawn, and counts twice. The
// texel of the back names the same two from the other side, and so the lobe of the lower one.
CLOTH_FN void cloth_stack(CLOTH_IN(ClothMaps) maps, CLOTH_INOUT(ClothSelection) selection, ClothSettings settings)
{
    if (CLOTH_STACKS == 0 || !(selection.yarn.beneath > real(0)) || selection.texel.gap || selection.passes || !(selection.weight > real(0))) return;
    if (selection.u < real(0.5)) {
        uvec2 back      = selection.texel.back;
        ClothYarn lower = cloth_fetch_yarn(maps, cloth_texel_yarn(back));
        real3 tangent   = cloth_fibre_tangent(maps, 1 - selection.side, back, cloth_decode_slopes(back.x), selection.texel.point.normal_b,
                                              selection.spot >> 2, selection.repeat, settings.twist_noise);
        selection.texel.point.tangent_t = cloth_mirror(tangent);
        selection.yarn.albedo_t         = lower.albedo_t;
        selection.yarn.alpha_t          = lower.alpha_t;
        selection.yarn.thickness_t      = lower.thickness;
    }
    selection.yarn.albedo_t *= real(2);
}

// What the ray meets at a found point.
//   u, stops  as cloth_reach takes them
//   return    passes, or a point whose value times `weight` is an estimate of the effective BSDF with cosine
CLOTH_FN ClothSelection cloth_meet(CLOTH_IN(ClothMaps) maps, int side, ClothFootprint footprint, ClothPlace place, real3 o,
                                   ClothSettings settings, real u, bool stops)
{
    ClothSelection result = cloth_reach(maps, side, footprint, place, o, settings, u, stops);
    cloth_stack(maps, result, settings);
    return result;
}

// Both at once.
CLOTH_FN ClothSelection cloth_select(CLOTH_IN(ClothMaps) maps, int side, ClothFootprint footprint, real3 o, ClothSettings settings,
                                     ClothRandom random)
{
    real2 u = cloth_draw(random, cloth_dim_pick);
    return cloth_meet(maps, side, footprint, cloth_find(maps, side, footprint, o, settings, random, u.x), o, settings, u.y, false);
}

// A straight way through the cloth at a point.
struct ClothCrossing {
    ivec2 spot;         // in quarters of a texel
    real3 up;           // the way, as it leaves the front: unit, local
    real share;         // of its light that the point itself lets by; 0: nothing gets through
    real unscattered;   // that a yarn beside the point lets by, where one is in the way
};

//   d  local unit direction of travel, either way
CLOTH_FN ClothCrossing cloth_crossing(CLOTH_IN(ClothMaps) maps, real2 tile, real3 d, ClothSettings settings)
{
    ivec2 spot = cloth_spot_at(maps, tile);
    uvec4 both = cloth_fetch_texels(maps, 0, spot >> 2);
    uvec2 word = uvec2(both.x, both.y);
    bool gap   = cloth_texel_is_gap(word);
    real3 up   = d * (real(1) - real(2) * real(d.z < real(0)));
    ClothCrossing crossing = ClothCrossing(spot, up, real(0), real(0));
    if (up.z <= real(0) || !(gap || settings.unscattered)) return crossing;
    crossing.share = real(1);
    if (settings.unscattered) {
        real2 slope  = cloth_decode_slopes(word.x);
        real facing  = up.z - dot(slope, real2(up.x, up.y));   // n.up times the length of n's area vector
        if (!gap && facing <= real(0)) return ClothCrossing(spot, up, real(0), real(0));
        ClothYarn yarn = cloth_fetch_yarn(maps, cloth_texel_yarn(word));
        real3 normal   = cloth_slope_normal(slope, cloth_area_length(slope));
        real3 tangent  = cloth_fibre_tangent(maps, 0, word, slope, normal, spot >> 2, ivec2(0, 0), false);
        crossing.unscattered = cloth_unscattered(yarn, normal, tangent, up);
        if (!gap) crossing.share = crossing.unscattered;
        // Points of the meso model count by their area, those of the micro model all alike, as in cloth_find.
        if (!gap && settings.bsdf == cloth_bsdf_meso) crossing.share *= facing / max(up.z, cloth_cosine_min);
    }
    return crossing;
}

// Share that is not in the way of yarns beside the point, on either side.
CLOTH_FN real cloth_crossing_clears(CLOTH_IN(ClothMaps) maps, ClothCrossing crossing, ClothSettings settings)
{
    if (!cloth_uses_visibility(settings)) return real(1);
    real3 up   = crossing.up;
    real2 v;   // of front and back
    if (settings.visibility == cloth_visibility_horizon8) {
        v = cloth_horizon_visibilities(cloth_fetch_horizons(maps, 0, cloth_horizon_at(maps, crossing.spot)), up);
    } else {
        v.x = cloth_visibility_at(maps, 0, crossing.spot, up, settings);
        v.y = cloth_visibility_at(maps, 1, crossing.spot, real3(-up.x, -up.y, up.z), settings);
    }
    return cloth_clears(v.x, crossing.unscattered) * cloth_clears(v.y, crossing.unscattered);
}

// Share of the light travelling along d that crosses the cloth at a point without being scattered. Zero footprint: the mean
// over the cloth is T_d [5.2], with the light between the fibres of a yarn added where the settings ask for it.
//   d  local unit direction of travel, either way;  return in [0, inf): mean over the repeat <= 1
CLOTH_FN real cloth_transmittance(CLOTH_IN(ClothMaps) maps, real2 tile, real3 d, ClothSettings settings)
{
    ClothCrossing crossing = cloth_crossing(maps, tile, d, settings);
    return crossing.share > real(0) ? crossing.share * cloth_crossing_clears(maps, crossing, settings) : real(0);
}
