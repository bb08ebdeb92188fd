// app/preview/software_threads.hpp: the threads that software GL draws with. Included by gl.cpp.
#pragma once

namespace selvedge
{

// Gives each of llvmpipe's threads a processor of its own, if there are as many of them as processors that the process
// may use. Linux wakes them on the processor that they are woken from, and takes some 50 ms to part them: until then
// frames take as long as on fewer processors. For a context that exists; does nothing on other systems and drivers.
void part_software_threads();

} // namespace selvedge
