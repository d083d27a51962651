"""Translation of JAX's list of primitive operations to vector code for LLVM."""
