//! The larger and the smaller of two floats that are numbers: `f32::max` and `f32::min` also handle
//! NaN, and are slower in loops over many.

#[inline(always)]
pub fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
pub fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
