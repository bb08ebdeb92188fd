// bake/program.hpp: what all selvedge programs do alike: errors to exit statuses, signals, --version, provenance of
// files.
#pragma once

#include <functional>
#include <map>
#include <string>

namespace CLI
{
class App;
}

namespace selvedge
{

// Runs `body` and turns what it throws into one line on stderr and an exit status: UsageError 2, anything else 1.
int run_program(const char* program, const std::function<int()>& body);

// Reads the command line into what `app` has bound. False: --help has been printed, and nothing else is to be done.
//   throws  UsageError
bool parse_command_line(CLI::App& app, int argc, const char* const* argv);

// From now on SIGINT and SIGTERM ask the program to end by itself: interrupted() is true. Another one, half a second
// later or more, ends it at once; not sooner, because timeout(1) sends two.
void end_by_itself_when_interrupted();
bool interrupted();

// "selvedge-bake 0.1.0 (git abc123)\nOpenImageIO 2.4.7, ...\n"; `libraries`: name -> version, one line for all.
std::string version_text(const char* program, const std::map<std::string, std::string>& libraries);
const char* version();      // "0.1.0"
const char* git_revision(); // "unknown" outside a checkout

// The command line, quoted where needed, for file headers.
std::string command_line(int argc, const char* const* argv);
// {"Software", "selvedge:version", "selvedge:git", "selvedge:command"} for image headers.
std::map<std::string, std::string> provenance(int argc, const char* const* argv);

} // namespace selvedge
