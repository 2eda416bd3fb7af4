#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| meshmend_fuzz::gltf(bytes));
