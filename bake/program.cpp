// bake/program.cpp: exit statuses, signals, version text, provenance.
#include "program.hpp"

#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>
#include <new>

#include <CLI/CLI.hpp>
#include <time.h>

#include "error.hpp"
#include "revision.hpp" // written by revision.cmake at every build

namespace selvedge
{

int run_program(const char* program, const std::function<int()>& body)
try {
    return body();
} catch (const UsageError& error) {
    std::fprintf(stderr, "%s: %s (see %s --help)\n", program, error.what(), program);
    return 2;
} catch (const std::bad_alloc&) {
    std::fprintf(stderr, "%s: out of memory\n", program);
    return 1;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", program, error.what());
    return 1;
}

bool parse_command_line(CLI::App& app, int argc, const char* const* argv)
{
    try {
        app.parse(argc, argv);
    } catch (const CLI::CallForHelp&) {
        std::fputs(app.help().c_str(), stdout);
        return false;
    } catch (const CLI::ParseError& error) {
        throw UsageError("%s", error.what());
    }
    return true;
}

static volatile std::sig_atomic_t interruptions = 0;
static volatile double interrupted_at = 0;

static void on_signal(int number)
{
    timespec now{};
    clock_gettime(CLOCK_MONOTONIC, &now); // one of the few calls that a handler may make
    const double seconds = static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
    if (interruptions > 0 && seconds - interrupted_at >= 0.5) {
        std::signal(number, SIG_DFL);
        std::raise(number);
    }
    if (interruptions > 0) return;
    interrupted_at = seconds;
    interruptions = 1;
}

void end_by_itself_when_interrupted()
{
    for (const int number : {SIGINT, SIGTERM}) std::signal(number, on_signal);
}

bool interrupted()
{
    return interruptions > 0;
}

std::string version_text(const char* program, const std::map<std::string, std::string>& libraries)
{
    std::string text = format_text("%s %s (git %s)\n", program, version(), git_revision());
    const char* separator = "";
    for (const auto& [name, number] : libraries) {
        text += separator + name + " " + number;
        separator = ", ";
    }
    return libraries.empty() ? text : text + "\n";
}

const char* version()
{
    return SELVEDGE_VERSION;
}

const char* git_revision()
{
    return SELVEDGE_REVISION;
}

std::string command_line(int argc, const char* const* argv)
{
    std::string line;
    for (int i = 0; i < argc; ++i) {
        const std::string word = argv[i];
        const bool plain = !word.empty() && word.find_first_of(" \t\n'\"\\$&|;<>()*?") == std::string::npos;
        line += i == 0 ? "" : " ";
        if (plain) {
            line += word;
            continue;
        }
        line += '\'';
        for (const char c : word) line += c == '\'' ? std::string("'\\''") : std::string(1, c);
        line += '\'';
    }
    return line;
}

std::map<std::string, std::string> provenance(int argc, const char* const* argv)
{
    return {{"Software", std::string("selvedge ") + version()},
            {"selvedge:version", version()},
            {"selvedge:git", git_revision()},
            {"selvedge:command", command_line(argc, argv)}};
}

} // namespace selvedge
