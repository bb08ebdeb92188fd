// bake/error.hpp: the two errors that people can cause. Anyone may include it; it includes nothing of ours.
#pragma once

#include <cstdarg>
#include <exception>
#include <string>

namespace selvedge
{

// printf into a std::string.
[[gnu::format(printf, 1, 0)]] std::string format_text_list(const char* format, std::va_list arguments);
[[gnu::format(printf, 1, 2)]] std::string format_text(const char* format, ...);

// What people wrote, for messages: at most 60 characters, "?" for what is not printable ASCII.
std::string printable(const std::string& text);

// Bad input or failed I/O: printed as `program: file:line: found, expected`, exit status 1.
//   file   the path as the person wrote it; empty where there is none
//   line   1-based; 0 where the error has no line (a missing file, an image)
class InputError : public std::exception
{
  public:
    [[gnu::format(printf, 4, 5)]] InputError(const std::string& file, int line, const char* format, ...);
    const char* what() const noexcept override { return text.c_str(); }

  private:
    std::string text;
};

// Wrong use of the command line: printed with a pointer to --help, exit status 2.
class UsageError : public std::exception
{
  public:
    [[gnu::format(printf, 2, 3)]] explicit UsageError(const char* format, ...);
    const char* what() const noexcept override { return text.c_str(); }

  private:
    std::string text;
};

} // namespace selvedge
