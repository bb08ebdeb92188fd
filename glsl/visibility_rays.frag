// Root: what each pixel of this frame sees, by rays.
#include "interop.h"
#include "cloth.h"
#include "blocks.h"
#include "visibility_rays.h"

layout(location = 0) out uvec4 id;

void main()
{
    id = first_met(gl_FragCoord.xy);
}
