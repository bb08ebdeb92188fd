// Root: radiance of this frame's sample of every pixel; the blend unit adds it to the sum of the block.
//   FABRIC  objects with fabric   GAPS  fabrics with gaps   MATTE  objects without   FOOTPRINT  several points a frame
//   CONVEX  nothing is in the way in front of a triangle   ONE_LIGHT  none has to be chosen
//   EMITTERS  objects that shine
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

vec3 direct_light(ClothMaps maps, ClothSurface surface, ClothShading shading, ClothRandom random)
{
    ClothDirect d = cloth_direct(frame_lights(), maps, surface, shading, frame_settings(), random);
    if (!d.any) return vec3(0.0);
#ifdef CONVEX
    if (dot(d.wi, surface.normal_g) * (surface.side == 0 ? 1.0 : -1.0) > 0.0) return d.value;
#endif
    vec3 side = surface.normal_g * (dot(d.wi, surface.normal_g) < 0.0 ? -1.0 : 1.0);
    return d.value * transmittance(cloth_leave(surface.position, side), d.wi, d.distance * (1.0 - 1e-4));
}

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
        if (!object.matte) {
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
#ifdef MATTE
#ifdef FABRIC
        if (object.matte)
#endif
        shading = cloth_shade_plain(object.albedo, object.roughness);
#endif
        sum += direct_light(object.maps, surface, shading, random);
    }
    // A sample that is not a number counts as 0, as in the reference: it would spoil its pixel for ever.
    bool good = all(greaterThanEqual(sum, vec3(0.0))) && all(lessThan(sum, vec3(1e30)));
    vec3 radiance = good ? sum / float(POINTS) : vec3(0.0);
#ifdef EMITTERS
    if (object.light >= 0) radiance += cloth_emitted(cloth_fetch_light(frame_lights(), object.light), surface.side);
#endif
    colour = vec4(radiance, 1.0);
}
