"""Arithmetic for compiled kernels: precisions, small vectors, SIMD, and the compilation cache."""
