// Root: what an earlier view knew of the places that the present frame shows. Only what lay at the same place on the same object
// counts; where there is no such thing, the pixel starts afresh.
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

void main()
{
    carried = vec4(0.0);
    ShownPlace here = shown_place(ivec2(gl_FragCoord.xy));
    vec3 d = here.object == 0.0 ? here.at : here.at - frame.past_position.xyz;
    float ahead = dot(d, frame.past_forward.xyz);
    if (ahead <= 0.0) return;
    vec2 seen  = vec2(dot(d, frame.past_right.xyz) * frame.past_right.w, -dot(d, frame.past_up.xyz) * frame.past_up.w) / ahead;
    ivec2 size = textureSize(past_picture, 0);
    // The place is that of this frame's ray; the past picture stands for pixel centres.
    vec2 pixel = (seen * 0.5 + 0.5) * vec2(size) - frame.film.zw * vec2(size) / frame.film.xy - 0.5;
    ivec2 base = ivec2(floor(pixel));
    vec2 f     = pixel - vec2(base);
    float total = 0.0;
    for (int k = 0; k < 4; ++k) {
        ivec2 step = ivec2(k & 1, k >> 1), xy = base + step;
        if (any(lessThan(xy, ivec2(0))) || any(greaterThanEqual(xy, size))) continue;
        vec4 place = texelFetch(past_place, xy, 0);
        if (place.w != here.object) continue;
        if (here.object > 0.0 && distance(place.xyz, here.at) > tolerance * here.across) continue;
        vec2 share   = mix(1.0 - f, f, vec2(step));
        float weight = share.x * share.y;
        carried += texelFetch(past_picture, xy, 0) * weight;
        total   += weight;
    }
    carried = total > 0.05 ? vec4(carried.rgb / total, carried.a) : vec4(0.0);
}
