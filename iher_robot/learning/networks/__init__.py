"""Networks: MLPs, critics, normalisers, precision, CUDA graphs, data parallelism."""
