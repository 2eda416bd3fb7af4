use super::{PAGES, Page};

const WHAT: &str = "# meshmend

> meshmend repairs broken 3D models over HTTP or on the command line, proves on the result's own bytes that it is printable, and gives an
> honest account of what changed.

Send a model to `POST /v1/jobs`, wait with `GET /v1/jobs/{id}?wait=20`, download `/v1/jobs/{id}/artifacts/model` and `report.json`.
`GET /v1/capabilities` says what this service takes and may do.

";

/// The pages with a line on each.
pub(super) fn list(pages: &[Page]) -> String {
    let line = |page: &Page| format!("- [{}](/docs/{}.md): {}\n", page.outline.title, page.name, page.outline.summary);
    let lines: String = pages.iter().filter(|page| !page.is_index()).map(line).collect();
    format!(
        "{WHAT}## Documentation\n\n{lines}\n## API\n\n- [OpenAPI 3.1](/openapi.json): every address, option and answer\n\
         - [Problems](/problems): every code of an error with what to do, as JSON\n\n## Optional\n\n\
         - [All pages in one](/llms-full.txt)\n"
    )
}

/// The pages one after the other.
pub(super) fn all() -> String {
    PAGES.iter().skip(1).map(|(_, text)| text.trim()).collect::<Vec<_>>().join("\n\n") + "\n"
}
