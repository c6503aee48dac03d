KPL/MK

Kernels of the simulated site; SPICE looks for them in the current folder.

\begindata
KERNELS_TO_LOAD = (
{listed}
)
\begintext
