// Catch2's main, once for all tests in C++.
#define CATCH_CONFIG_MAIN
#include <catch2/catch.hpp>
