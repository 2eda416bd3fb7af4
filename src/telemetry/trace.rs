use std::collections::HashMap;

use opentelemetry::propagation::TextMapPropagator;
use opentelemetry::trace::{Status, TraceContextExt};
use opentelemetry_sdk::propagation::TraceContextPropagator;
use tracing::Span;
use tracing_opentelemetry::OpenTelemetrySpanExt;

/// The name of the header, and of what a job carries from its request to its worker (W3C Trace Context).
pub const TRACEPARENT: &str = "traceparent";

/// Makes a span part of the trace that a traceparent tells of, or the first of a new one, and notes the trace's name in the
/// span's field `trace_id`, so that all log lines of a piece of work share it in every process. A traceparent that can't be read
/// is passed over, as the standard asks. To be called before the span is entered.
pub fn continue_from(span: &Span, traceparent: Option<&str>) {
    let carrier = traceparent.map(|it| (TRACEPARENT.to_owned(), it.to_owned()));
    let parent = TraceContextPropagator::new().extract(&carrier.into_iter().collect::<HashMap<_, _>>());
    if parent.span().span_context().is_valid() {
        // Fails where nothing collects spans, as in tests of single rooms.
        let _ = span.set_parent(parent);
    }
    let context = span.context();
    let context = context.span().span_context().clone();
    if context.is_valid() {
        span.record("trace_id", tracing::field::display(context.trace_id()));
    }
}

/// What to hand to whoever goes on with a span's work elsewhere; none where nothing collects spans.
#[must_use]
pub fn traceparent(span: &Span) -> Option<String> {
    let mut carrier = HashMap::new();
    TraceContextPropagator::new().inject_context(&span.context(), &mut carrier);
    carrier.remove(TRACEPARENT)
}

/// Notes what became of a request, by the names that OpenTelemetry has for it.
pub fn answered(span: &Span, route: &str, status: u16) {
    span.set_attribute("http.route", route.to_owned());
    span.set_attribute("http.response.status_code", i64::from(status));
    if status >= 500 {
        span.set_status(Status::error(""));
    }
}

/// Notes that a piece of work failed.
pub fn failed(span: &Span, why: String) {
    span.set_status(Status::error(why));
}
