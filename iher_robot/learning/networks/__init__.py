"""Networks and tensor machinery: MLPs, critics, normalizer, precision, CUDA graphs."""
