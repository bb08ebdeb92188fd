// Root: radiance of this frame's sample of every pixel; the blend unit adds it to the sum of the block.
//   FABRIC  objects with fabric   GAPS  fabrics with gaps   MATTE  objects without   FOOTPRINT  several points a frame
//   CONVEX  nothing is in the way in front of a triangle   ONE_LIGHT  none has to be chosen
//   EMITTERS  objects that shine   BOUNCES  paths of up to frame.random.w surfaces
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#include "trace.h"

uniform usampler2D id_map;
layout(location = 0) out vec4 colour;   // radiance, coverage

// Selections after the first are drawn from those that stop the ray, which is what the first one is known to have done.
const uint attempts = 8u;

#ifdef FOOTPRINT
#define POINTS frame.random.z
#else
#define POINTS 1u
#endif

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

vec3 direct_light(ClothMaps maps, ClothSurface surface, ClothShading shading, ClothRandom random)
{
    ClothDirect d = cloth_direct(frame_lights(), maps, surface, shading, frame_settings(), random);
    if (!d.any) return vec3(0.0);
    if (is_outward(surface, d.wi)) return d.value;
    vec3 side = surface.normal_g * (dot(d.wi, surface.normal_g) < 0.0 ? -1.0 : 1.0);
    return d.value * transmittance(cloth_leave(surface.position, side), d.wi, d.distance * (1.0 - 1e-4));
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
            hit    = closest(ray.origin, ray.direction, hit);
            passes = false;
            if (hit.object < 0) break;
            object  = fetch_object(hit.object);
            surface = cloth_surface(fetch_triangle(object.first_triangle + hit.triangle), ray);
#ifdef FABRIC
            if (!is_matte(object)) {
                ClothRandom cloth = layer_random(random.seed, hit.object, hit.triangle, random.offset / cloth_dims_per_vertex);
                ClothSelection selection = cloth_select(object.maps, surface.side, footprint_on(object, hit.triangle, surface), surface.wo,
                                                        frame_settings(), cloth);
#ifdef GAPS
                passes = selection.passes;
#endif
                shading = cloth_shade_fabric(selection, frame_settings());
            }
#endif
            if (is_matte(object)) shading = cloth_shade_plain(object.albedo, object.roughness);
        }
        if (hit.object < 0) break;   // the environment: direct light has counted it, and what shines
        sum += throughput * direct_light(object.maps, surface, shading, random);
    }
    return sum;
}
#endif

void main()
{
    uvec4 id     = texelFetch(id_map, ivec2(gl_FragCoord.xy), 0);
    ClothRay ray = frame_ray(gl_FragCoord.xy);
    if (id.x == 0u) {
        colour = vec4(cloth_background(frame_lights(), normalize(ray.direction)), 0.0);
        return;
    }
    int object_index = int(id.x) - 1, triangle_index = int(id.y);
    SceneObject object   = fetch_object(object_index);
    ClothSurface surface = cloth_surface(fetch_triangle(object.first_triangle + triangle_index), ray);
    uint seed = pixel_seed(gl_FragCoord.xy);
    vec3 sum  = vec3(0.0);
    ClothShading shading;
#ifdef FOOTPRINT
    ClothSelection first;
#endif
    for (uint n = 0u; n < POINTS; ++n) {
        ClothRandom random = layer_random(seed, object_index, triangle_index, n * attempts);
#ifdef FABRIC
        if (!is_matte(object)) {
            ClothFootprint footprint = footprint_on(object, triangle_index, surface);
            vec2 u = cloth_draw(random, cloth_dim_pick);
            ClothPlace place;
#ifdef GAPS
            if (n == 0u && handed_over(id.zw)) place = take_over(id.zw);
            else
#endif
            place = cloth_find(object.maps, surface.side, footprint, surface.wo, frame_settings(), random, u.x);
#ifdef FOOTPRINT
            bool stops = n == 0u;
#else
            const bool stops = true;
#endif
            ClothSelection selection = cloth_meet(object.maps, surface.side, footprint, place, surface.wo, frame_settings(), u.y, stops);
#if defined(GAPS) && defined(FOOTPRINT)
            for (uint k = 1u; n > 0u && selection.passes && k < attempts; ++k)
                selection = cloth_select(object.maps, surface.side, footprint, surface.wo, frame_settings(),
                                         layer_random(seed, object_index, triangle_index, n * attempts + k));
            if (selection.passes && n > 0u) selection = first;
#endif
#ifdef FOOTPRINT
            if (n == 0u) first = selection;
#endif
            shading = cloth_shade_fabric(selection, frame_settings());
        }
#endif
        if (is_matte(object)) shading = cloth_shade_plain(object.albedo, object.roughness);
        sum += direct_light(object.maps, surface, shading, random);
#ifdef BOUNCES
        sum += bounced_light(object, surface, shading, random);
#endif
    }
    // A sample that is not a number counts as 0, as in the reference: it would spoil its pixel for ever.
    bool good = all(greaterThanEqual(sum, vec3(0.0))) && all(lessThan(sum, vec3(1e30)));
    vec3 radiance = good ? sum / float(POINTS) : vec3(0.0);
#ifdef EMITTERS
    if (object.light >= 0) radiance += cloth_emitted(cloth_fetch_light(frame_lights(), object.light), surface.side);
#endif
    colour = vec4(radiance, 1.0);
}
