//! Heap, stack and image, and what of them is used. One core, no interrupts.

use core::alloc::{GlobalAlloc, Layout};
use core::cell::UnsafeCell;
use core::ptr::{NonNull, addr_of};
use linked_list_allocator::Heap;

unsafe extern "C" {
    static __image_start: u8;
    static __text_end: u8;
    static __rodata_end: u8;
    static __bss_end: u8;
    static __stack_bottom: u8;
    static __heap_start: u8;
    static __heap_end: u8;
}

/// What the heap was asked for.
#[derive(Clone, Copy)]
pub struct Use {
    /// Allocations since start.
    pub calls: u64,
    /// Bytes in use.
    pub in_use: usize,
    /// Most bytes that were ever in use.
    pub most: usize,
}

struct Counted(UnsafeCell<(Heap, Use)>);

// SAFETY: one core, and exceptions end the run.
unsafe impl Sync for Counted {}

#[global_allocator]
static HEAP: Counted = Counted(UnsafeCell::new((
    Heap::empty(),
    Use {
        calls: 0,
        in_use: 0,
        most: 0,
    },
)));

// SAFETY: the heap's own promises; nothing else runs beside it.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the only reference, see above.
        let (heap, used) = unsafe { &mut *self.0.get() };
        let found = heap.allocate_first_fit(layout);
        used.calls += 1;
        used.in_use = heap.used();
        used.most = used.most.max(used.in_use);
        found.map_or(core::ptr::null_mut(), NonNull::as_ptr)
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the only reference; `at` came from this heap with this layout.
        unsafe {
            let (heap, used) = &mut *self.0.get();
            if let Some(at) = NonNull::new(at) {
                heap.deallocate(at, layout);
            }
            used.in_use = heap.used();
        }
    }
}

/// Gives the heap its memory. Once, before the first allocation.
pub fn give_heap() {
    let (start, end) = (addr_of!(__heap_start), addr_of!(__heap_end));
    // SAFETY: the linker's script keeps this range for the heap alone.
    unsafe { (*HEAP.0.get()).0.init(start.cast_mut(), end as usize - start as usize) }
}

/// What of the heap is used.
pub fn heap() -> Use {
    // SAFETY: nothing allocates meanwhile.
    unsafe { (*HEAP.0.get()).1 }
}

/// Bytes of code, of constants, of statics.
pub fn image() -> (usize, usize, usize) {
    let at = [
        addr_of!(__image_start),
        addr_of!(__text_end),
        addr_of!(__rodata_end),
        addr_of!(__bss_end),
    ]
    .map(|symbol| symbol as usize);
    (at[1] - at[0], at[2] - at[1], at[3] - at[2])
}

const PAINT: u64 = 0x5ac4_5ac4_5ac4_5ac4;
/// What lies below the stack pointer and is left alone: the painter's own frame.
const MARGIN: usize = 512;

fn stack_pointer() -> usize {
    let sp: usize;
    // SAFETY: reads a register.
    unsafe { core::arch::asm!("mov {}, sp", out(reg) sp) };
    sp
}

/// Marks the unused stack.
#[inline(never)]
pub fn paint_stack() {
    let (mut at, end) = (addr_of!(__stack_bottom) as usize, stack_pointer() - MARGIN);
    while at < end {
        // SAFETY: stack that nothing uses.
        unsafe { (at as *mut u64).write_volatile(PAINT) };
        at += 8;
    }
}

/// Bytes of stack that were used at the deepest since [`paint_stack`].
#[inline(never)]
pub fn deepest_stack() -> usize {
    let mut at = addr_of!(__stack_bottom) as usize;
    // SAFETY: reads the stack's memory up to what is in use.
    while at < stack_pointer() && unsafe { (at as *const u64).read_volatile() } == PAINT {
        at += 8;
    }
    addr_of!(__heap_start) as usize - at
}

/// The machine's counter.
pub fn count() -> u64 {
    let count: u64;
    // SAFETY: reads a register.
    unsafe { core::arch::asm!("isb", "mrs {}, cntvct_el0", out(reg) count) };
    count
}

/// How fast it counts.
pub fn count_hz() -> u64 {
    let hz: u64;
    // SAFETY: reads a register.
    unsafe { core::arch::asm!("mrs {}, cntfrq_el0", out(reg) hz) };
    hz
}
