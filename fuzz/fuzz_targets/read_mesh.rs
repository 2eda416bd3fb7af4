#![no_main]

use libfuzzer_sys::Corpus;
use meshmend::format::Format;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| -> Corpus {
    if meshmend_fuzz::read_as(Format::Mesh, bytes) { Corpus::Keep } else { Corpus::Reject }
});
