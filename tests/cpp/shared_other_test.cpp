// The second includer of the shared source; see shared_test.cpp.
#include "cloth_bsdf.hpp"

double sigma_of_the_other_file(glm::dvec3 w, glm::dvec3 t, double alpha);

double sigma_of_the_other_file(glm::dvec3 w, glm::dvec3 t, double alpha)
{
    return cloth::f64::cloth_sggx_sigma(w, t, alpha);
}
