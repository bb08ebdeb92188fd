// app/window.hpp: the window of selvedge-lookdev. Included by main.cpp.
#pragma once

#include <map>
#include <string>

namespace selvedge
{

std::map<std::string, std::string> window_library_versions(); // GLFW, Dear ImGui

} // namespace selvedge
