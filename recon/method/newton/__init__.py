"""Second-order minimisation of a stage: Gauss-Newton Hessians in bands, and two uses of them."""
