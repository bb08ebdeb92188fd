// What a pixel of this frame shows: radiance of its samples. The id map says what stops a pixel's ray; or, where several samples share it,
// what it meets first, which some of them may pass. GLSL only; shade.frag and shade.comp include it after trace.h.
//   CAMERA_RAYS  in place of the rasteriser and its id map: what a pixel sees is found here
//   FABRIC  objects with fabric   GAPS  fabrics with gaps   MATTE  objects without   FOOTPRINT  several samples a frame
//   LAYERS  samples walk from layer to layer: FOOTPRINT and GAPS
//   CONVEX  nothing is in the way in front of a triangle   FEW_LIGHTS  LIGHT_COUNT of them, none of which has to be chosen
//   SKY  the first of several lights is an environment, and all others of one kind, OTHER_LIGHTS, or -1
//   EMITTERS  objects that shine   BOUNCES  paths of up to frame.random.w surfaces

#ifndef CAMERA_RAYS
uniform usampler2D id_map;
#endif
uvec2 seen;   // object + 1 and triangle that stopped the first sample's ray; 0: none

// Whether an object is known to stop the ray.
bool stops(SceneObject object)
{
#if defined(LAYERS)
    return false;   // the visibility pass does not know
#elif defined(CAMERA_RAYS)
    return !object.gaps;
#else
    return true;
#endif
}

bool is_matte(SceneObject object)
{
#if defined(MATTE) && defined(FABRIC)
    return object.matte;
#elif defined(MATTE)
    return true;
#else
    return false;
#endif
}

// What leaves in front of a triangle of a convex body meets nothing.
bool is_outward(ClothSurface surface, vec3 wi)
{
#ifdef CONVEX
    return dot(wi, surface.normal_g) * (surface.side == 0 ? 1.0 : -1.0) > 0.0;
#else
    return false;
#endif
}

// What one light brings.
//   kind    of the light, where the compiler may know it; -1
//   bright  luminance of what other lights have brought
vec3 light_of_slot(ClothMaps maps, ClothSurface surface, ClothShading shading, ClothRandom random, int slot, int slots, int kind, float bright)
{
    ClothRandom own         = cloth_slot_random(random, slot);
    vec2 u                  = cloth_draw(own, cloth_dim_light);
    ClothLightChoice choice = cloth_ask_light(frame_lights(), slot, slots, u.x);
    if (kind >= 0) choice.light.kind = kind;
    ClothDirect d = cloth_direct(frame_lights(), maps, surface, shading, frame_settings(), own, choice);
    if (!d.any) return vec3(0.0);
    if (is_outward(surface, d.wi)) return d.value;
    vec3 side    = surface.normal_g * (dot(d.wi, surface.normal_g) < 0.0 ? -1.0 : 1.0);
    float brings = cloth_luminance(d.value);
    return d.value * transmittance(cloth_leave(surface.position, side), d.wi, d.distance * (1.0 - 1e-4), cloth_least(brings, bright + brings), u.y);
}

//   first  vertex of its path
vec3 direct_light(ClothMaps maps, ClothSurface surface, ClothShading shading, ClothRandom random, bool first)
{
    vec3 sum  = vec3(0.0);
    int slots = cloth_light_slots(frame_lights(), first);
#ifdef SKY
    // The sky last: where a sun shines it matters less. By itself, as is a single other light: the compiler then knows what each light's
    // kind is, and leaves out what is for others.
    if (first) {
#if LIGHT_COUNT == 2
        sum = light_of_slot(maps, surface, shading, random, 1, slots, OTHER_LIGHTS, 0.0);
#else
        for (int slot = slots - 1; slot > 0; --slot)
            sum += light_of_slot(maps, surface, shading, random, slot, slots, OTHER_LIGHTS, cloth_luminance(sum));
#endif
        return sum + light_of_slot(maps, surface, shading, random, 0, slots, cloth_light_environment, cloth_luminance(sum));
    }
#endif
    for (int slot = slots - 1; slot >= 0; --slot)
        sum += light_of_slot(maps, surface, shading, random, slot, slots, -1, cloth_luminance(sum));
    return sum;
}

#ifdef BOUNCES
// What paths bring to a shaded point beyond its direct light. random: the first vertex's.
vec3 bounced_light(SceneObject object, ClothSurface surface, ClothShading shading, ClothRandom random)
{
    vec3 sum = vec3(0.0), throughput = vec3(1.0);
    for (int depth = 1; depth < int(frame.random.w); ++depth) {
        ClothBounce bounce = cloth_bounce(object.maps, surface, shading, frame_settings(), random, throughput);
        if (!bounce.any || is_outward(surface, bounce.wi)) break;
        throughput = bounce.throughput;
        random.offset += cloth_dims_per_vertex;
        if (depth > cloth_roulette_start) {
            float survival = cloth_survival(throughput);
            if (cloth_draw(random, cloth_dim_pixel).x >= survival) break;
            throughput /= survival;
        }
        ClothRay ray = cloth_bounce_ray(bounce);
        Hit hit      = Hit(-1, -1, 0.0);
        bool passes  = true;
        while (passes) {
            hit    = closest(ray.origin, ray.direction, all_nodes(), hit);
            passes = false;
            if (hit.object < 0) break;
            object  = fetch_object(hit.object);
            surface = cloth_surface(fetch_triangle(object.first_triangle + hit.triangle), ray);
#ifdef FABRIC
            if (!is_matte(object)) {
                ClothSelection selection = cloth_select(object.maps, surface.side, footprint_on(object, hit.triangle, surface), surface.wo,
                                                        frame_settings(), layer_random(random, hit.object, hit.triangle));
#ifdef GAPS
                passes = selection.passes;
#endif
                shading = cloth_shade_fabric(selection, frame_settings());
            }
#endif
            if (is_matte(object)) shading = cloth_shade_plain(object.albedo, object.roughness);
        }
        if (hit.object < 0) break;   // the environment: direct light has counted it, and what shines
        sum += throughput * direct_light(object.maps, surface, shading, random, false);
    }
    return sum;
}
#endif

// What a ray meets.
struct Met {
    int index, triangle;
    SceneObject object;
    ClothSurface surface;
};

Met meet(int index, int triangle, ClothRay ray)
{
    SceneObject object = fetch_object(index);
    return Met(index, triangle, object, cloth_surface(fetch_triangle(object.first_triangle + triangle), ray));
}

// What stopped the ray of a sample sends back.
vec3 radiance(Met met, ClothShading shading, ClothRandom random)
{
    vec3 sum = direct_light(met.object.maps, met.surface, shading, random, true);
#ifdef BOUNCES
    sum += bounced_light(met.object, met.surface, shading, random);
#endif
    // A sample that is not a number counts as 0, as in the reference: it would spoil its pixel for ever.
    if (!(all(greaterThanEqual(sum, vec3(0.0))) && all(lessThan(sum, vec3(1e30))))) sum = vec3(0.0);
#ifdef EMITTERS
    if (met.object.light >= 0) sum += cloth_emitted(cloth_fetch_light(frame_lights(), met.object.light), met.surface.side);
#endif
    return sum;
}

// Whether a sample goes through what its ray meets.
//   found      by the visibility pass: a point of it, see hand_over
//   selection  gets what it reaches of a fabric that stops it
bool goes_through(Met met, ClothRandom random, uvec2 found, out ClothSelection selection)
{
#ifdef FABRIC
    if (!is_matte(met.object)) {
        ClothFootprint footprint = footprint_on(met.object, met.triangle, met.surface);
        vec2 u = cloth_draw(random, cloth_dim_pick);
        ClothPlace place;
#if defined(GAPS) && !defined(LAYERS) && !defined(CAMERA_RAYS)
        if (handed_over(found)) place = take_over(found);
        else
#endif
        place = cloth_find(met.object.maps, met.surface.side, footprint, met.surface.wo, frame_settings(), random, u.x);
        selection = cloth_reach(met.object.maps, met.surface.side, footprint, place, met.surface.wo, frame_settings(), u.y, stops(met.object));
        return selection.passes;
    }
#endif
    return false;
}

//   selection  reached, of a fabric
ClothShading shading_of(SceneObject object, ClothSelection selection)
{
#ifdef FABRIC
    if (!is_matte(object)) {
#if defined(CAMERA_RAYS) && defined(GAPS) && !defined(FOOTPRINT)
        // The loop that the ray has been in asks of a yarn what lets light pass: the rest is for the last one alone.
        selection.yarn = cloth_fetch_yarn(object.maps, selection.texel.yarn);
#endif
        cloth_stack(object.maps, selection, frame_settings());
        return cloth_shade_fabric(selection, frame_settings());
    }
#endif
    return cloth_shade_plain(object.albedo, object.roughness);
}

#ifdef FOOTPRINT
// All samples of a pixel in a frame have one ray, so that it is followed but once: from layer to layer, as long as a sample passes.
//   first, count  of the samples
//   met           the first layer
vec4 sum_of(vec2 pixel_centre, ClothRay ray, ClothRandom random, uint first, uint count, Met met)
{
    vec4 sum     = vec4(0.0);
    uint walking = 0xffffffffu >> (32u - count);   // a bit for each sample that nothing has stopped yet
#ifdef LAYERS
    ivec2 nodes = nodes_of_pixel(pixel_centre);
    // By how far the walk's own distance to the first layer may be rounded otherwise.
    float distance = dot(met.surface.position - ray.origin, ray.direction) / dot(ray.direction, ray.direction) * (1.0 + 1e-6);
    Hit hit        = Hit(met.index, met.triangle, distance);
#endif
    while (walking != 0u) {
        uint passing = 0u;
        for (uint left = walking; left != 0u; left &= left - 1u) {
            uint n          = first + uint(findLSB(left));
            ClothRandom own = layer_random(ClothRandom(random.seed, random.index + n, random.offset), met.index, met.triangle);
            ClothSelection selection;
            if (goes_through(met, own, uvec2(0u), selection)) {
                passing |= left & -left;
            } else {
                sum += vec4(radiance(met, shading_of(met.object, selection), own), 1.0);
                if (n == 0u) seen = uvec2(uint(met.index + 1), uint(met.triangle));
            }
        }
        walking = passing;
#ifdef LAYERS
        if (walking != 0u) {
            // From the distance that the walk found itself: each hit is then farther than the last. Two triangles in the same place, or
            // both hit at their common edge, would else come next behind each other for ever.
            hit = closest(ray.origin, ray.direction, nodes, hit);
            if (hit.object < 0) {
                sum += background(ray) * float(bitCount(walking));
                walking = 0u;
            } else {
                met = meet(hit.object, hit.triangle, ray);
            }
        }
#endif
    }
    return sum;
}
#endif

// Mean radiance and coverage of this frame's samples of a pixel.
vec4 mean_colour(vec2 pixel_centre)
{
    ClothRay ray       = frame_ray(pixel_centre);
    ClothRandom random = ClothRandom(pixel_seed(pixel_centre), frame.random.y, 0u);
    seen               = uvec2(0u);
    Met met;
    ClothRandom own;   // of the layer that is met
    ClothSelection selection;
#ifdef CAMERA_RAYS
    ivec2 nodes = nodes_of_pixel(pixel_centre);
    Hit hit     = Hit(-1, -1, 0.0);
    bool passes;
    do {
        hit    = closest(ray.origin, ray.direction, nodes, hit);
        passes = false;
        if (hit.object >= 0) {
            met = meet(hit.object, hit.triangle, ray);
            own = layer_random(random, met.index, met.triangle);
#ifndef FOOTPRINT
            passes = goes_through(met, own, uvec2(0u), selection);
#endif
        }
    } while (passes);
    if (hit.object < 0) return background(ray);
#else
    uvec4 id = texelFetch(id_map, ivec2(pixel_centre), 0);
    if (id.x == 0u) return background(ray);
    met = meet(int(id.x) - 1, int(id.y), ray);
    own = layer_random(random, met.index, met.triangle);
#ifndef FOOTPRINT
    goes_through(met, own, id.zw, selection);   // it does not, or the id map would say what is behind
#endif
#endif
#ifdef FOOTPRINT
    vec4 sum = vec4(0.0);
    for (uint first = 0u; first < frame.random.z; first += 32u) sum += sum_of(pixel_centre, ray, random, first, min(frame.random.z - first, 32u), met);
    return sum / float(frame.random.z);
#else
    seen = uvec2(uint(met.index + 1), uint(met.triangle));
    return vec4(radiance(met, shading_of(met.object, selection), own), 1.0);
#endif
}
