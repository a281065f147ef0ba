// Packets of 512 bits: the kernels for AVX-512.
#include "kernel.hpp"

namespace whitted {

const Kernels kernels_avx512{"avx512", Kernel<double, 8>::trace_span, Kernel<float, 16>::trace_span};

}  // namespace whitted
