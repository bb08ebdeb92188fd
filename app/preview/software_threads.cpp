// app/preview/software_threads.cpp: by the names that Mesa gives its threads, in /proc.
#include "app/preview/software_threads.hpp"

#ifdef __linux__
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <sched.h>
#endif

namespace selvedge
{

#ifdef __linux__
void part_software_threads()
{
    namespace fs = std::filesystem;
    std::error_code ended; // threads come and go
    std::vector<pid_t> threads;
    for (fs::directory_iterator at("/proc/self/task", ended), end; !ended && at != end; at.increment(ended)) {
        std::ifstream file(at->path() / "comm");
        std::string name;
        if (std::getline(file, name) && name.starts_with("llvmpipe-"))
            threads.push_back(std::atoi(at->path().filename().c_str()));
    }
    cpu_set_t ours;
    if (sched_getaffinity(0, sizeof ours, &ours) != 0) return; // more processors than the set has room for
    std::vector<int> processors;
    for (int processor = 0; processor < CPU_SETSIZE; ++processor)
        if (CPU_ISSET(processor, &ours)) processors.push_back(processor);
    if (threads.size() != processors.size()) return;
    for (std::size_t k = 0; k < threads.size(); ++k) {
        cpu_set_t own;
        CPU_ZERO(&own);
        CPU_SET(processors[k], &own);
        sched_setaffinity(threads[k], sizeof own, &own); // one that has ended needs none
    }
}
#else
void part_software_threads() {}
#endif

} // namespace selvedge
