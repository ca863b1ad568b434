//! Depth frames and lockstep exchanges over iceoryx2 shared memory.
