// Root: before the view changes, what is on show and where its things are.
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "scene_buffers.h"
#include "place.h"
#include "shown.h"

layout(location = 0) out vec4 picture;   // rgb; a samples that it stands for
layout(location = 1) out vec4 place;     // xyz; w object, see ShownPlace

// Samples that the past may stand for, so that what changes with the view (highlights, light behind edges) is not kept for long.
const float samples_limit = 24.0;

void main()
{
    ivec2 xy = ivec2(gl_FragCoord.xy);
    picture  = shown_at(xy);
    picture.a = min(picture.a, samples_limit);
    ShownPlace found = shown_place(xy);
    place = vec4(found.at, found.object);
}
