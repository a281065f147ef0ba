// The power of the kernels by itself. Reads lines "f64|f32 X N INTEGER" with X and N as hexadecimal floats, prints X^N.
// INTEGER: N where it is to be multiplied out, else -1.
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "power.hpp"

int main() {
    char precision[4], x[64], n[64];
    int integer = 0;
    while (std::scanf("%3s %63s %63s %d", precision, x, n, &integer) == 4) {
        if (std::strcmp(precision, "f64") == 0) {
            const whitted::Packet<double, 1> base(std::strtod(x, nullptr));
            std::printf("%a\n", whitted::power(base, std::strtod(n, nullptr), integer).v);
        } else {
            const whitted::Packet<float, 1> base(std::strtof(x, nullptr));
            std::printf("%a\n", static_cast<double>(whitted::power(base, std::strtof(n, nullptr), integer).v));
        }
    }
}
