// From reset to `main`: one core, its own vectors, floating point, memory mapped one to one, zeroed statics, a stack.
    .section .text.boot, "ax"
    .globl _start
_start:
    mrs     x0, mpidr_el1
    and     x0, x0, #0xff
    cbnz    x0, halt
    ldr     x0, =vectors
    msr     vbar_el1, x0
    // Floating point and NEON without traps.
    mov     x0, #(3 << 20)
    msr     cpacr_el1, x0
    isb
    // Zero the statics.
    ldr     x0, =__bss_start
    ldr     x1, =__bss_end
1:  cmp     x0, x1
    b.hs    2f
    stp     xzr, xzr, [x0], #16
    b       1b
2:  // Two blocks of 1 GiB, one to one: the first with the devices, the second with the memory, cacheable.
    ldr     x0, =table
    mov     x1, #0x401              // block, accessed, attribute 0
    str     x1, [x0]
    mov     x1, #0x705              // block, accessed, inner shareable, attribute 1
    orr     x1, x1, #0x40000000
    str     x1, [x0, #8]
    mov     x1, #0xff00             // attribute 0: device; 1: normal, write-back
    msr     mair_el1, x1
    ldr     x1, =0x200803519        // 39-bit addresses, 4 KiB granule, cacheable walks, no upper half
    msr     tcr_el1, x1
    msr     ttbr0_el1, x0
    dsb     sy
    tlbi    vmalle1
    dsb     sy
    isb
    mrs     x1, sctlr_el1
    mov     x2, #0x1005             // translation, data cache, instruction cache
    orr     x1, x1, x2
    msr     sctlr_el1, x1
    isb
    ldr     x0, =__stack_top
    mov     sp, x0
    bl      main
halt:
    wfe
    b       halt

    // Every exception ends the run: nothing here expects one.
    .balign 2048
vectors:
    .rept 16
    .balign 128
    mrs     x0, esr_el1
    mrs     x1, elr_el1
    mrs     x2, far_el1
    b       fault
    .endr

    .section .bss
    .balign 4096
table:
    .skip 4096
