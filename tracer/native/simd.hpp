// Packets of floating point numbers: the one place that knows vector widths. Included by kernel_*.cpp and limits_*.cpp.
//
// Everything here is in an unnamed namespace and always inlined, so that no function compiled for one instruction set
// can be linked into another's path, and no vector crosses a call.
#pragma once

#include <cstddef>
#include <cstdint>

#if defined(__SSE2__)
#include <immintrin.h>
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#endif

#define WHITTED_INLINE __attribute__((always_inline)) inline
// Large functions: the checks of a sanitizer make them too large to compile in one piece.
#if defined(__SANITIZE_ADDRESS__)
#define WHITTED_LARGE __attribute__((noinline))
#else
#define WHITTED_LARGE WHITTED_INLINE
#endif

namespace whitted {
namespace {

template <class Real>
struct BitsOf;
template <>
struct BitsOf<double> {
    using type = std::int64_t;
};
template <>
struct BitsOf<float> {
    using type = std::int32_t;
};

template <class T, int Width>
struct Vector {
    typedef T type __attribute__((vector_size(sizeof(T) * Width)));
};
template <class T>
struct Vector<T, 1> {
    using type = T;
};

// Yes or no for each lane. Generic: all bits of an integer vector; one lane: a bool; AVX-512: a mask register.
template <class Real, int Width>
struct MaskOf {
    using type = typename Vector<typename BitsOf<Real>::type, Width>::type;
};
template <class Real>
struct MaskOf<Real, 1> {
    using type = bool;
};
#if defined(__AVX512F__)
template <>
struct MaskOf<double, 8> {
    using type = __mmask8;
};
template <>
struct MaskOf<float, 16> {
    using type = __mmask16;
};
#endif

template <class Real, int Width>
inline constexpr bool has_mask_register =
#if defined(__AVX512F__)
    sizeof(Real) * Width == 64;
#else
    false;
#endif

template <class Real, int Width>
struct Mask {
    using Native = typename MaskOf<Real, Width>::type;
    Native m;

    WHITTED_INLINE static Mask none() {
        if constexpr (Width == 1) {
            return {false};
        } else {
            return {Native{}};
        }
    }
    WHITTED_INLINE static Mask all() { return !none(); }

    friend WHITTED_INLINE Mask operator&(Mask a, Mask b) {
        if constexpr (Width == 1) {
            return {a.m && b.m};
        } else {
            return {static_cast<Native>(a.m & b.m)};
        }
    }
    friend WHITTED_INLINE Mask operator|(Mask a, Mask b) {
        if constexpr (Width == 1) {
            return {a.m || b.m};
        } else {
            return {static_cast<Native>(a.m | b.m)};
        }
    }
    friend WHITTED_INLINE Mask operator!(Mask a) {
        if constexpr (Width == 1) {
            return {!a.m};
        } else {
            return {static_cast<Native>(~a.m)};
        }
    }
};

// Packets of two registers: each operation is done on both, and neither waits for the other. With 128 and 256 bits that
// makes up for what they spill, and more; with 512 bits, where masks spill as well, it does not.
inline constexpr int register_bytes =
#if defined(__AVX512F__)
    64;
#elif defined(__AVX__)
    32;
#else
    16;
#endif
template <class Real, int Width>
concept Pair = sizeof(Real) * Width == 2 * register_bytes;

template <class Real, int Width>
    requires Pair<Real, Width>
struct Mask<Real, Width> {
    using Half = Mask<Real, Width / 2>;
    Half low, high;

    WHITTED_INLINE static Mask none() { return {Half::none(), Half::none()}; }
    WHITTED_INLINE static Mask all() { return {Half::all(), Half::all()}; }

    friend WHITTED_INLINE Mask operator&(Mask a, Mask b) { return {a.low & b.low, a.high & b.high}; }
    friend WHITTED_INLINE Mask operator|(Mask a, Mask b) { return {a.low | b.low, a.high | b.high}; }
    friend WHITTED_INLINE Mask operator!(Mask a) { return {!a.low, !a.high}; }
};

template <class Real, int Width>
WHITTED_INLINE bool any(Mask<Real, Width> mask) {
    if constexpr (Pair<Real, Width>) {
        return any(mask.low | mask.high);
    } else if constexpr (Width == 1 || has_mask_register<Real, Width>) {
        return mask.m != 0;
#if defined(__AVX__)
    } else if constexpr (sizeof(Real) * Width == 32) {
        return !_mm256_testz_si256(reinterpret_cast<__m256i>(mask.m), reinterpret_cast<__m256i>(mask.m));
#endif
#if defined(__SSE2__)
    } else if constexpr (sizeof(Real) * Width == 16) {
        return _mm_movemask_epi8(reinterpret_cast<__m128i>(mask.m)) != 0;
#endif
    } else {
        typename BitsOf<Real>::type found = 0;
        for (int lane = 0; lane < Width; ++lane) found |= mask.m[lane];
        return found != 0;
    }
}

// Width numbers that are computed on together.
template <class Real, int Width>
struct Packet {
    using Native = typename Vector<Real, Width>::type;
    using Lanes = Mask<Real, Width>;
    Native v;

    Packet() = default;
    WHITTED_INLINE Packet(Real x) : v(broadcast(x)) {}
    WHITTED_INLINE explicit Packet(Native native, int) : v(native) {}

    WHITTED_INLINE static Packet load(const Real *from) {
        Packet p;
        __builtin_memcpy(&p.v, from, sizeof(p.v));
        return p;
    }
    WHITTED_INLINE void store(Real *to) const { __builtin_memcpy(to, &v, sizeof(v)); }

    friend WHITTED_INLINE Packet operator+(Packet a, Packet b) { return Packet(a.v + b.v, 0); }
    friend WHITTED_INLINE Packet operator-(Packet a, Packet b) { return Packet(a.v - b.v, 0); }
    friend WHITTED_INLINE Packet operator*(Packet a, Packet b) { return Packet(a.v * b.v, 0); }
    friend WHITTED_INLINE Packet operator/(Packet a, Packet b) { return Packet(a.v / b.v, 0); }
    WHITTED_INLINE Packet operator-() const { return Packet(-v, 0); }

    friend WHITTED_INLINE Lanes operator<(Packet a, Packet b) {
#if defined(__AVX512F__)
        if constexpr (has_mask_register<Real, Width>) {
            if constexpr (sizeof(Real) == 8) {
                return {_mm512_cmp_pd_mask(a.v, b.v, _CMP_LT_OQ)};
            } else {
                return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LT_OQ)};
            }
        } else
#endif
            return {a.v < b.v};
    }
    friend WHITTED_INLINE Lanes operator>(Packet a, Packet b) { return b < a; }
    friend WHITTED_INLINE Lanes operator<=(Packet a, Packet b) {
#if defined(__AVX512F__)
        if constexpr (has_mask_register<Real, Width>) {
            if constexpr (sizeof(Real) == 8) {
                return {_mm512_cmp_pd_mask(a.v, b.v, _CMP_LE_OQ)};
            } else {
                return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LE_OQ)};
            }
        } else
#endif
            return {a.v <= b.v};
    }
    friend WHITTED_INLINE Lanes operator>=(Packet a, Packet b) { return b <= a; }
    friend WHITTED_INLINE Lanes operator==(Packet a, Packet b) {
#if defined(__AVX512F__)
        if constexpr (has_mask_register<Real, Width>) {
            if constexpr (sizeof(Real) == 8) {
                return {_mm512_cmp_pd_mask(a.v, b.v, _CMP_EQ_OQ)};
            } else {
                return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_EQ_OQ)};
            }
        } else
#endif
            return {a.v == b.v};
    }

  private:
    WHITTED_INLINE static Native broadcast(Real x) {
        if constexpr (Width == 1) {
            return x;
        } else {
            return x - Native{};  // minus +0 keeps the sign of -0
        }
    }
};

template <class Real, int Width>
    requires Pair<Real, Width>
struct Packet<Real, Width> {
    using Half = Packet<Real, Width / 2>;
    using Lanes = Mask<Real, Width>;
    Half low, high;

    Packet() = default;
    WHITTED_INLINE Packet(Real x) : low(x), high(x) {}
    WHITTED_INLINE Packet(Half first, Half second) : low(first), high(second) {}

    WHITTED_INLINE static Packet load(const Real *from) { return {Half::load(from), Half::load(from + Width / 2)}; }
    WHITTED_INLINE void store(Real *to) const {
        low.store(to);
        high.store(to + Width / 2);
    }

    friend WHITTED_INLINE Packet operator+(Packet a, Packet b) { return {a.low + b.low, a.high + b.high}; }
    friend WHITTED_INLINE Packet operator-(Packet a, Packet b) { return {a.low - b.low, a.high - b.high}; }
    friend WHITTED_INLINE Packet operator*(Packet a, Packet b) { return {a.low * b.low, a.high * b.high}; }
    friend WHITTED_INLINE Packet operator/(Packet a, Packet b) { return {a.low / b.low, a.high / b.high}; }
    WHITTED_INLINE Packet operator-() const { return {-low, -high}; }

    friend WHITTED_INLINE Lanes operator<(Packet a, Packet b) { return {a.low < b.low, a.high < b.high}; }
    friend WHITTED_INLINE Lanes operator>(Packet a, Packet b) { return b < a; }
    friend WHITTED_INLINE Lanes operator<=(Packet a, Packet b) { return {a.low <= b.low, a.high <= b.high}; }
    friend WHITTED_INLINE Lanes operator>=(Packet a, Packet b) { return b <= a; }
    friend WHITTED_INLINE Lanes operator==(Packet a, Packet b) { return {a.low == b.low, a.high == b.high}; }
};

// Lane by lane: yes ? a : b.
template <class Real, int Width>
WHITTED_INLINE Packet<Real, Width> select(Mask<Real, Width> yes, Packet<Real, Width> a, Packet<Real, Width> b) {
    using P = Packet<Real, Width>;
    if constexpr (Pair<Real, Width>) {
        return P(select(yes.low, a.low, b.low), select(yes.high, a.high, b.high));
    } else
#if defined(__AVX512F__)
        if constexpr (has_mask_register<Real, Width>) {
        if constexpr (sizeof(Real) == 8) {
            return P(_mm512_mask_blend_pd(yes.m, b.v, a.v), 0);
        } else {
            return P(_mm512_mask_blend_ps(yes.m, b.v, a.v), 0);
        }
    } else
#endif
        return P(yes.m ? a.v : b.v, 0);
}

template <class Real, int Width>
WHITTED_INLINE Mask<Real, Width> select(Mask<Real, Width> yes, Mask<Real, Width> a, Mask<Real, Width> b) {
    return (yes & a) | ((!yes) & b);
}

template <class Real, int Width>
WHITTED_INLINE Packet<Real, Width> sqrt(Packet<Real, Width> x) {
    using P = Packet<Real, Width>;
    if constexpr (Pair<Real, Width>) {
        return P(sqrt(x.low), sqrt(x.high));
    } else if constexpr (Width == 1) {
        if constexpr (sizeof(Real) == 8) {
            return P(__builtin_sqrt(x.v));
        } else {
            return P(__builtin_sqrtf(x.v));
        }
#if defined(__AVX512F__)
    } else if constexpr (sizeof(Real) * Width == 64) {
        if constexpr (sizeof(Real) == 8) {
            return P(_mm512_maskz_sqrt_pd(__mmask8(~0), x.v), 0);
        } else {
            return P(_mm512_maskz_sqrt_ps(__mmask16(~0), x.v), 0);
        }
#endif
#if defined(__AVX__)
    } else if constexpr (sizeof(Real) * Width == 32) {
        if constexpr (sizeof(Real) == 8) {
            return P(_mm256_sqrt_pd(x.v), 0);
        } else {
            return P(_mm256_sqrt_ps(x.v), 0);
        }
#endif
#if defined(__SSE2__)
    } else if constexpr (sizeof(Real) * Width == 16) {
        if constexpr (sizeof(Real) == 8) {
            return P(_mm_sqrt_pd(x.v), 0);
        } else {
            return P(_mm_sqrt_ps(x.v), 0);
        }
#elif defined(__ARM_NEON)
    } else if constexpr (sizeof(Real) * Width == 16) {
        if constexpr (sizeof(Real) == 8) {
            return P(vsqrtq_f64(x.v), 0);
        } else {
            return P(vsqrtq_f32(x.v), 0);
        }
#endif
    }
}

// a < b ? a : b
template <class Real, int Width>
WHITTED_INLINE Packet<Real, Width> minimum(Packet<Real, Width> a, Packet<Real, Width> b) {
#if defined(__AVX512F__)
    if constexpr (has_mask_register<Real, Width>) {
        using P = Packet<Real, Width>;
        if constexpr (sizeof(Real) == 8) {
            return P(_mm512_maskz_min_pd(__mmask8(~0), a.v, b.v), 0);
        } else {
            return P(_mm512_maskz_min_ps(__mmask16(~0), a.v, b.v), 0);
        }
    } else
#endif
        return select(a < b, a, b);
}

// a < b ? b : a
template <class Real, int Width>
WHITTED_INLINE Packet<Real, Width> maximum(Packet<Real, Width> a, Packet<Real, Width> b) {
#if defined(__AVX512F__)
    if constexpr (has_mask_register<Real, Width>) {
        using P = Packet<Real, Width>;
        if constexpr (sizeof(Real) == 8) {
            return P(_mm512_maskz_max_pd(__mmask8(~0), b.v, a.v), 0);
        } else {
            return P(_mm512_maskz_max_ps(__mmask16(~0), b.v, a.v), 0);
        }
    } else
#endif
        return select(a < b, b, a);
}

template <class Real, int Width>
WHITTED_INLINE Packet<Real, Width> absolute(Packet<Real, Width> a) {
    return select(a < Packet<Real, Width>(Real(0)), -a, a);
}

// Red, green and blue of 8 bits in one word, from whole numbers 0 .. 255 with any fraction, which is cut off.
template <class Real, int Width>
WHITTED_INLINE void store_words(std::int32_t *to, Packet<Real, Width> r, Packet<Real, Width> g, Packet<Real, Width> b) {
    if constexpr (Pair<Real, Width>) {
        store_words(to, r.low, g.low, b.low);
        store_words(to + Width / 2, r.high, g.high, b.high);
    } else if constexpr (Width == 1) {
        *to =
            static_cast<std::int32_t>(r.v) | static_cast<std::int32_t>(g.v) << 8 | static_cast<std::int32_t>(b.v) << 16;
    } else {
        using Words = typename Vector<std::int32_t, Width>::type;
        const Words words = __builtin_convertvector(r.v, Words) | __builtin_convertvector(g.v, Words) << 8 |
                            __builtin_convertvector(b.v, Words) << 16;
        __builtin_memcpy(to, &words, sizeof(words));
    }
}

// The lower three bytes of each word, one after the other. `words` may be read up to the next multiple of 16.
WHITTED_INLINE void pack_words(std::uint8_t *to, const std::int32_t *words, std::size_t count) {
    std::size_t k = 0;
#if defined(__AVX512BW__)
    const __m512i low_three = _mm512_maskz_broadcast_i32x4(
        __mmask16(~0), _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1));
    const __m512i together = _mm512_setr_epi32(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 3, 7, 11, 15);
    for (; k < count; k += 16) {
        const __m512i bytes = _mm512_maskz_permutexvar_epi32(
            __mmask16(0x0fff), together,
            _mm512_shuffle_epi8(_mm512_loadu_si512(static_cast<const void *>(words + k)), low_three));
        const std::size_t left = 3 * (count - k);
        _mm512_mask_storeu_epi8(to + 3 * k, left < 48 ? (__mmask64(1) << left) - 1 : (__mmask64(1) << 48) - 1, bytes);
    }
#elif defined(__AVX2__)
    const __m256i low_three =
        _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1));
    const __m256i together = _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 3, 7);
    for (; k + 11 <= count; k += 8) {  // 32 bytes are written, of which 24 count
        const __m256i four = _mm256_loadu_si256(reinterpret_cast<const __m256i *>(words + k));
        _mm256_storeu_si256(reinterpret_cast<__m256i *>(to + 3 * k),
                            _mm256_permutevar8x32_epi32(_mm256_shuffle_epi8(four, low_three), together));
    }
#endif
    for (; k + 2 <= count; ++k) __builtin_memcpy(to + 3 * k, words + k, 4);  // the fourth byte is overwritten
    for (; k < count; ++k)
        for (int c = 0; c < 3; ++c)
            to[3 * k + static_cast<std::size_t>(c)] = static_cast<std::uint8_t>(words[k] >> 8 * c);
}

// The bit pattern of a packet as integers, and back.
template <class Real, int Width>
using BitsPacket = typename Vector<typename BitsOf<Real>::type, Width>::type;

template <class Real, int Width>
WHITTED_INLINE BitsPacket<Real, Width> to_bits(Packet<Real, Width> x) {
    BitsPacket<Real, Width> bits;
    __builtin_memcpy(&bits, &x.v, sizeof(bits));
    return bits;
}

template <class Real, int Width>
WHITTED_INLINE Packet<Real, Width> from_bits(BitsPacket<Real, Width> bits) {
    Packet<Real, Width> x;
    __builtin_memcpy(&x.v, &bits, sizeof(bits));
    return x;
}

}  // namespace
}  // namespace whitted
