// Root: what an earlier view knew of the places that the present frame shows. Only where the same place on the same object was
// seen, there or beside, and of that only pixels of objects that are still there or beside; elsewhere the pixel starts afresh.
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#include "place.h"

uniform sampler2D past_picture;
uniform sampler2D past_place;
layout(location = 0) out vec4 carried;

// How far apart two places may lie to be the same, in extents of a pixel: the jitter of two frames and the distance of neighbours.
const float tolerance = 3.0;
// Samples that the past may stand for where objects mix: they move at different speeds, and what trails behind is gone the sooner.
const float mixed_limit = 8.0;

// Whether the present frame shows the object in the pixel or beside it.
bool is_near(ivec2 pixel, float object)
{
    ivec2 last = textureSize(seen_map, 0) - 1;
    for (int k = 0; k < 9; ++k) {
        ivec2 xy = clamp(pixel + ivec2(k % 3, k / 3) - 1, ivec2(0), last);
        if (float(texelFetch(seen_map, xy, 0).x) == object) return true;
    }
    return false;
}

void main()
{
    carried = vec4(0.0);
    ivec2 pixel     = ivec2(gl_FragCoord.xy);
    ShownPlace here = shown_place(pixel);
    vec3 d = here.object == 0.0 ? here.at : here.at - frame.past_position.xyz;
    float ahead = dot(d, frame.past_forward.xyz);
    if (ahead <= 0.0) return;
    vec2 seen  = vec2(dot(d, frame.past_right.xyz) * frame.past_right.w, -dot(d, frame.past_up.xyz) * frame.past_up.w) / ahead;
    ivec2 size = textureSize(past_picture, 0);
    // The place is that of this frame's ray; the past picture stands for pixel centres.
    vec2 past  = (seen * 0.5 + 0.5) * vec2(size) - frame.film.zw * vec2(size) / frame.film.xy - 0.5;
    ivec2 base = ivec2(floor(past));
    vec2 f     = past - vec2(base);
    float total = 0.0;
    bool known  = false, mixed = false;
    for (int k = 0; k < 16; ++k) {
        ivec2 step = ivec2(k % 4, k / 4) - 1, xy = base + step;
        if (any(lessThan(xy, ivec2(0))) || any(greaterThanEqual(xy, size))) continue;
        vec4 place = texelFetch(past_place, xy, 0);
        bool same  = place.w == here.object && (here.object == 0.0 || distance(place.xyz, here.at) <= tolerance * here.across);
        known = known || same;
        if (any(lessThan(step, ivec2(0))) || any(greaterThan(step, ivec2(1)))) continue;
        // Edges and sheer cloth: one ray of the past met one of the objects that a pixel shows, the picture has them all.
        if (!same && (place.w == here.object || !is_near(pixel, place.w))) continue;
        mixed = mixed || !same;
        vec2 share   = mix(1.0 - f, f, vec2(step));
        float weight = share.x * share.y;
        carried += texelFetch(past_picture, xy, 0) * weight;
        total   += weight;
    }
    if (!known || total <= 0.05) {
        carried = vec4(0.0);
        return;
    }
    carried.rgb /= total;
    if (mixed) carried.a = min(carried.a, mixed_limit);
}
