// app/preview/context.hpp: GL contexts without a window, through EGL or OSMesa. Included by the headless program and
// tests.
#pragma once

#include <memory>
#include <string>

#include "gl.hpp"

namespace selvedge
{

enum class Backend { automatic, egl, osmesa }; // automatic: EGL, then OSMesa

// A current, off-screen GL core context of the highest version in 4.5 ... 4.1 that the driver gives. One at a time.
class Context
{
  public:
    virtual ~Context() = default;
    const char* backend = ""; // "egl" or "osmesa"
    GlInfo info;

    // Creates it, makes it current, loads the GL functions.
    //   throws  std::runtime_error that lists everything that was tried and why it failed
    static std::unique_ptr<Context> create(Backend backend);
};

Backend parse_backend(const std::string& word); // throws UsageError

} // namespace selvedge
