// bake/error.cpp: printf-like construction of the two errors.
#include "error.hpp"

#include <cstdio>

namespace selvedge
{

std::string format_text_list(const char* format, std::va_list arguments)
{
    std::va_list again;
    va_copy(again, arguments);
    const int length = std::vsnprintf(nullptr, 0, format, again);
    va_end(again);
    if (length <= 0) return {};
    std::string text(static_cast<std::size_t>(length), '\0');
    std::vsnprintf(text.data(), text.size() + 1, format, arguments);
    return text;
}

std::string format_text(const char* format, ...)
{
    std::va_list arguments;
    va_start(arguments, format);
    std::string text = format_text_list(format, arguments);
    va_end(arguments);
    return text;
}

std::string printable(const std::string& text)
{
    std::string out;
    for (const char c : text.substr(0, 60)) out += c >= ' ' && c < 127 ? c : '?';
    return text.size() > 60 ? out + "..." : out;
}

InputError::InputError(const std::string& file, int line, const char* format, ...)
{
    std::va_list arguments;
    va_start(arguments, format);
    if (!file.empty()) text = line > 0 ? file + ":" + std::to_string(line) + ": " : file + ": ";
    text += format_text_list(format, arguments);
    va_end(arguments);
}

UsageError::UsageError(const char* format, ...)
{
    std::va_list arguments;
    va_start(arguments, format);
    text = format_text_list(format, arguments);
    va_end(arguments);
}

} // namespace selvedge
