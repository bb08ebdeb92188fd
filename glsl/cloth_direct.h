// Direct light at a shaded surface: everything but the shadow ray. Shared; imports all of the above. The preview does, for each of
// cloth_light_slots,
//   ClothDirect d = cloth_direct(..., cloth_ask_light(...));  if (d.any) colour += d.value * share of the light that arrives;
// the reference the same with cloth_direct_by, once for each strategy that the light has.

// A shader that is told that there is no metal (CLOTH_METAL 0) has no code for it.
#ifndef CLOTH_METAL
#define CLOTH_METAL 1
#endif

// Light between yarns at a point.
struct ClothBetween {
    real3 r;      // albedo of what comes from the viewer's side [9.1]
    real3 t;      // from the other side
    real share;   // probability of sampling it: its share in the albedo, as for the lobes of a point [6.5]
    real front;   // share of r in that
};

// What is shaded: a chosen point of a fabric, or matte, or metal.
struct ClothShading {
    bool matte;                 // no fabric
    real3 albedo;               // not of fabrics; of metal its reflectance at normal incidence
    real roughness;             // of metal: alpha of GGX; 0: no metal
    ClothSelection selection;   // fabric only
    ClothBetween between;       // light between yarns
};

struct ClothDirect {
    bool any;        // false: no shadow ray is needed
    real3 wi;        // unit, world
    real distance;   // [m] to the light
    real3 value;     // radiance toward the viewer if nothing is in the way
    real lit;        // about which share that is of what it were if the point had no yarn in its light, (0, 1]
};

// Shadow rays that bring less than this share of what their sample has (from this light in full, from those that were asked before what
// has arrived) are left to a roulette: a ray that cloth has let through costs as much as several that end there, and brings little. At
// 0.25 a sample of the demo costs a quarter less in the preview and the error grows by 0.5 %; at 1 it costs no less and the error grows
// by 8 % (measured with one of its two lights at a time).
// In the reference "in full" is as if the point had no yarn in its light (ClothDirect::lit): rays for light between yarns alone have a
// roulette before they set out. A sample of the demo costs 6 % less, and relMSE grows by 3 %. In the preview it would save 2 % of a
// frame: a ray less among sixteen that go in step.
CLOTH_CONST real cloth_faint = real(0.25);

// Below what is left of its light a shadow ray's roulette begins, as a share of what the ray brings; 0: it has none.
//   brings  luminance of what it brings if nothing is in the way;  all  of what its sample has, the ray's included
CLOTH_FN real cloth_least(real brings, real all)
{
    if (!(brings > real(0))) return real(0);   // luminance may have underflowed
    real least = cloth_faint * all / brings;
    return least < real(1e30) ? least : real(0);
}

// What a shadow ray has left of its light, and what decides in a roulette: [0, 1), stretched to be uniform again each time.
struct ClothShare {
    real left;
    real u;
};

// Russian roulette: where less than `least` is left, the ray goes on with a probability of left / least, as one that has `least`.
CLOTH_FN ClothShare cloth_shadow_roulette(ClothShare share, real least)
{
    if (share.left >= least) return share;
    real p = share.left / least;
    if (share.u < p) return ClothShare(least, share.u / p);
    return ClothShare(real(0), share.u);
}

// An object without fabric: metal where it has a roughness, matte otherwise.
CLOTH_FN ClothShading cloth_shade_plain(real3 albedo, real roughness)
{
    ClothShading shading;
    shading.matte     = true;
    shading.albedo    = albedo;
    shading.roughness = roughness;
    shading.between   = ClothBetween(real3(real(0)), real3(real(0)), real(0), real(0));
    return shading;
}

CLOTH_FN ClothShading cloth_shade_matte(real3 albedo)
{
    return cloth_shade_plain(albedo, real(0));
}

CLOTH_FN bool cloth_shading_is_metal(CLOTH_IN(ClothShading) shading)
{
    return CLOTH_METAL != 0 && shading.matte && shading.roughness > real(0);
}

CLOTH_FN bool cloth_lights_between(ClothSettings settings)
{
    return settings.interreflection && settings.bsdf == cloth_bsdf_meso;
}

CLOTH_FN ClothBetween cloth_between(CLOTH_IN(ClothSelection) selection, ClothSettings settings)
{
    if (!cloth_lights_between(settings)) return ClothBetween(real3(real(0)), real3(real(0)), real(0), real(0));
    ClothRegained light = cloth_interreflection(selection.yarn.albedo, real2(selection.texel.openness_f, selection.texel.openness_b));
    real3 r    = selection.yarn.reflectance * light.front;
    real3 t    = selection.yarn.transmittance * light.back;
    // The compiler may round the luminance otherwise where it is part of the sum: never more than all of it.
    real front = cloth_luminance(r), lobe = front + cloth_luminance(t);
    real point = cloth_luminance(selection.yarn.albedo_r + selection.yarn.albedo_t + selection.yarn.diffuse_r + selection.yarn.diffuse_t);
    return ClothBetween(r, t, lobe / max(lobe + point, real(1e-20)), min(front / max(lobe, real(1e-20)), real(1)));
}

CLOTH_FN ClothShading cloth_shade_fabric(CLOTH_IN(ClothSelection) selection, ClothSettings settings)
{
    ClothShading shading;
    shading.matte     = false;
    shading.albedo    = real3(real(0));
    shading.roughness = real(0);
    shading.selection = selection;
    shading.between   = cloth_between(selection, settings);
    return shading;
}

struct ClothValue {
    real3 value;   // effective BSDF times cosine, visibility of wi included
    real lit;      // as ClothDirect has it: 1 where the horizon lets any light by, else the share of light between yarns
};

//   maps  of the fabric that the shading was chosen from; anything where it is matte
CLOTH_FN ClothValue cloth_shading_lit(CLOTH_IN(ClothMaps) maps, CLOTH_IN(ClothShading) shading, real3 wi, real3 wo, ClothSettings settings)
{
    if (cloth_shading_is_metal(shading)) return ClothValue(cloth_metal_value(shading.albedo, shading.roughness, wi, wo), real(1));
    if (shading.matte) return ClothValue(shading.albedo * (max(wi.z, real(0)) / cloth_pi), real(1));
    bool reflected = wi.z > real(0);
    real v         = cloth_selection_visibility(maps, shading.selection, !reflected, real3(wi.x, wi.y, abs(wi.z)), settings);
    real3 value = real3(real(0));
    if (v > real(0))
        value = cloth_point_value(shading.selection.texel.point, shading.selection.yarn, wi, wo, settings.slab) * v;
    // Light that reached the point by way of other yarns has no horizon of its own: openness has counted it.
    bool between = cloth_lights_between(settings);
    if (between) value += (reflected ? shading.between.r : shading.between.t) * (abs(wi.z) / cloth_pi);
    return ClothValue(value * shading.selection.weight, between && v <= real(0) ? max(shading.between.share, real(1e-6)) : real(1));   // the share may have underflowed
}

CLOTH_FN real3 cloth_shading_value(CLOTH_IN(ClothMaps) maps, CLOTH_IN(ClothShading) shading, real3 wi, real3 wo, ClothSettings settings)
{
    return cloth_shading_lit(maps, shading, wi, wo, settings).value;
}

// Density of the light between yarns [1/sr].
CLOTH_FN real cloth_between_pdf(CLOTH_IN(ClothShading) shading, real3 wi)
{
    return (wi.z > real(0) ? shading.between.front : real(1) - shading.between.front) * abs(wi.z) / cloth_pi;
}

// Density of cloth_shading_sample [1/sr].
CLOTH_FN real cloth_shading_pdf(CLOTH_IN(ClothShading) shading, real3 wi, real3 wo, ClothSettings settings)
{
    if (cloth_shading_is_metal(shading)) return cloth_metal_pdf(shading.roughness, wi, wo);
    if (shading.matte) return max(wi.z, real(0)) / cloth_pi;
    real pdf = cloth_point_pdf(shading.selection.texel.point, shading.selection.yarn, wi, wo);
    return cloth_lights_between(settings) ? mix(pdf, cloth_between_pdf(shading, wi), shading.between.share) : pdf;
}

// A direction of light. u_lobe chooses the lobe, u the direction in it; all in [0, 1).
CLOTH_FN ClothSample cloth_shading_sample(CLOTH_IN(ClothShading) shading, real3 wo, ClothSettings settings, real2 u_lobe, real2 u)
{
    if (cloth_shading_is_metal(shading)) return cloth_metal_sample(shading.roughness, wo, u);
    real share = shading.matte ? real(1) : shading.between.share;
    if (u_lobe.x < share) {
        real3 wi = cloth_cosine_sample(real3(real(0), real(0), real(1)), u);
        if (!shading.matte && u_lobe.x >= share * shading.between.front) wi = cloth_mirror(wi);
        return ClothSample(wi, cloth_shading_pdf(shading, wi, wo, settings));
    }
    real2 u_point = real2(min((u_lobe.x - share) / max(real(1) - share, real(1e-6)), real(0.99999994)), u_lobe.y);
    ClothSample s = cloth_point_sample(shading.selection.texel.point, shading.selection.yarn, wo, u_point, u);
    if (s.pdf > real(0)) s.pdf = mix(s.pdf, cloth_between_pdf(shading, s.wi), share);
    return s;
}

// A light that is asked, with pmf how likely it was to be; u is stretched to be uniform again.
struct ClothLightChoice {
    ClothLight light;
    real u;
};

// One of the lights from `first` on, in proportion to their pmf.
CLOTH_FN ClothLightChoice cloth_choose_light(CLOTH_IN(ClothLights) lights, int first, real u)
{
    // The last one is certain. Said before the loop: software GL would go through it once.
    if (first + 1 == lights.count) {
        ClothLight only = cloth_fetch_light(lights, first);
        only.pmf        = real(1);
        return ClothLightChoice(only, u);
    }
    real all = real(1);
    for (int k = 0; k < first; ++k) all -= cloth_fetch_light(lights, k).pmf;
    u *= all;
    int chosen = first;
    real below = real(0), pmf = cloth_fetch_light(lights, first).pmf;
    while (chosen + 1 < lights.count && u >= below + pmf) {
        below += pmf;
        ++chosen;
        pmf = cloth_fetch_light(lights, chosen).pmf;
    }
    ClothLight light = cloth_fetch_light(lights, chosen);
    light.pmf = pmf / all;
    return ClothLightChoice(light, clamp((u - below) / pmf, real(0), real(0.99999994)));
}

// What a camera ray meets asks every light, as long as there are few: one at a time leaves the sum of a sky and a sun with two to
// three times the variance. The last that is asked stands for all from there on.
CLOTH_CONST int cloth_lights_asked = 4;

// How many lights a vertex asks. On from the second of a path it is one.
//   first  the path's first vertex
CLOTH_FN int cloth_light_slots(CLOTH_IN(ClothLights) lights, bool first)
{
    return first ? min(lights.count, cloth_lights_asked) : min(lights.count, 1);
}

//   slot, slots  which of how many;  u  [0, 1)
CLOTH_FN ClothLightChoice cloth_ask_light(CLOTH_IN(ClothLights) lights, int slot, int slots, real u)
{
    if (slot + 1 == slots) return cloth_choose_light(lights, slot, u);
    ClothLight light = cloth_fetch_light(lights, slot);
    light.pmf        = real(1);
    return ClothLightChoice(light, u);
}

// Random numbers of a slot: the dimensions are the same for all.
CLOTH_FN uint cloth_slot_seed(uint seed, int slot)
{
    return slot == 0 ? seed : cloth_hash_combine(seed, uint(slot));
}

CLOTH_FN ClothRandom cloth_slot_random(ClothRandom random, int slot)
{
    return ClothRandom(cloth_slot_seed(random.seed, slot), random.index, random.offset);
}

// Whether BSDF sampling finds a chosen light with profit, too.
CLOTH_FN bool cloth_light_has_two_ways(CLOTH_IN(ClothLight) light, CLOTH_IN(ClothShading) shading)
{
    return cloth_light_wants_bsdf(light, cloth_shading_is_metal(shading));
}

// One sample of a chosen light by one strategy: light sampling or, where it finds that light, BSDF sampling. The two are
// weighted by the balance heuristic (Veach 1997, 9.2).
//   share   how often the strategy is taken: 1 where each of the two is taken and their values added (multi-sample MIS), 1/2
//           where either is (one-sample MIS, 9.2.4); 0: there is no other
//   u_lobe  of BSDF sampling
CLOTH_FN ClothDirect cloth_direct_by(CLOTH_IN(ClothLights) lights, CLOTH_IN(ClothMaps) maps, CLOTH_IN(ClothSurface) surface,
                                     CLOTH_IN(ClothShading) shading, ClothSettings settings, ClothRandom random,
                                     CLOTH_IN(ClothLightChoice) choice, bool use_bsdf, real share, real2 u_lobe)
{
    ClothDirect none = ClothDirect(false, surface.normal_g, cloth_far, real3(real(0)), real(1));
    real2 u_emit     = cloth_draw(random, use_bsdf ? cloth_dim_direction : cloth_dim_subtexel);
    ClothLightSample seen;
    ClothSample s = ClothSample(real3(real(0), real(0), real(1)), real(0));
    if (use_bsdf) {
        s = cloth_shading_sample(shading, surface.wo, settings, u_lobe, u_emit);
        if (s.pdf <= real(0)) return none;
        seen = cloth_light_hit(lights, choice.light, surface.position, cloth_to_world(surface.frame, s.wi));
    } else {
        seen = cloth_light_sample(lights, choice.light, surface.position, u_emit, cloth_draw_bits(random, cloth_dim_emitter));
    }
    if (seen.pdf <= real(0)) return none;
    real3 wi = use_bsdf ? s.wi : cloth_to_local(surface.frame, seen.wi);
    // Shading and geometric normal must agree on the side that the light is on [math.md 10, hazard 23].
    if (wi.z * dot(seen.wi, surface.normal_g) <= real(0)) return none;
    ClothValue shaded = cloth_shading_lit(maps, shading, wi, surface.wo, settings);
    real3 value       = shaded.value * seen.radiance;
    if (!(value.x + value.y + value.z > real(0))) return none;
    real pdf = seen.pdf;
    if (share > real(0)) pdf = share * (seen.pdf + (use_bsdf ? s.pdf : cloth_shading_pdf(shading, wi, surface.wo, settings)));
    return ClothDirect(true, seen.wi, seen.distance, value * (real(1) / (pdf * choice.light.pmf)), shaded.lit);
}

// One sample of a light: at most one shadow ray. Where the light has two strategies both are tried, and one of the two is kept,
// with a probability in proportion to what it brings if nothing is in the way: where nothing is, that is as good as both
// (resampled importance sampling: Talbot, Cline & Egbert 2005).
//   maps    of the fabric that the shading was chosen from; anything where it is matte
//   random  of the light's slot
CLOTH_FN ClothDirect cloth_direct(CLOTH_IN(ClothLights) lights, CLOTH_IN(ClothMaps) maps, CLOTH_IN(ClothSurface) surface,
                                  CLOTH_IN(ClothShading) shading, ClothSettings settings, ClothRandom random,
                                  CLOTH_IN(ClothLightChoice) choice)
{
    bool both    = cloth_light_has_two_ways(choice.light, shading);
    real2 u_lobe = both ? cloth_draw(random, cloth_dim_lobe) : real2(real(0));
    // Each strategy by itself, not in a loop: software GL takes every branch, and so would both work for either.
    ClothDirect kept = cloth_direct_by(lights, maps, surface, shading, settings, random, choice, false, both ? real(1) : real(0), u_lobe);
    real share = kept.any ? cloth_luminance(kept.value) : real(0), total = share;
    if (both) {
        ClothDirect tried = cloth_direct_by(lights, maps, surface, shading, settings, random, choice, true, real(1), u_lobe);
        real brings = tried.any ? cloth_luminance(tried.value) : real(0);
        total += brings;
        if (brings > real(0) && choice.u * total < brings) {
            kept  = tried;
            share = brings;
        }
        if (share > real(0)) kept.value = kept.value * (total / share);   // luminance may have underflowed to 0
    }
    return kept;
}

// Radiance of the environment behind everything, 0 where there is none or it is hidden from the camera.
CLOTH_FN real3 cloth_background(CLOTH_IN(ClothLights) lights, real3 direction)
{
    if (lights.count == 0 || lights.environment_size.x == 0) return real3(real(0));
    ClothLight light = cloth_fetch_light(lights, 0);   // the environment, where there is one, is light 0
    if (!cloth_light_is(light, cloth_light_environment) || light.shape.y > real(0)) return real3(real(0));
    real4 seen = cloth_environment(lights, light, direction);
    return real3(seen.x, seen.y, seen.z);
}
