"""Translation of a jaxpr, JAX's list of primitive operations, to LLVM code on SIMD vectors."""
