// Packets of two registers of 256 bits: the kernels for AVX2.
#include "kernel.hpp"

namespace whitted {

const Kernels kernels_avx2{"avx2", Kernel<double, 8>::trace_span, Kernel<float, 16>::trace_span};

}  // namespace whitted
