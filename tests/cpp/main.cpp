// main() of selvedge-tests; the tests are the other files of this folder.
#define CATCH_CONFIG_MAIN
#include <catch2/catch.hpp>
