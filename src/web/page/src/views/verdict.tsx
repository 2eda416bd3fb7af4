import type { ComponentChildren } from "preact";
import type { Job, Options, Report } from "meshmend-client";
import { isOpenSheet, optionsOf } from "../report/advice";
import { repairSummary, remainingDefects } from "../report/summary";
import { type Remark, assumptionsOf, notesOf, warningsOf, withOption } from "../report/remarks";
import { claimsOf } from "../report/verdict";
import type { Unit } from "../units";
import { useWords } from "../words/locale";
import { Icon } from "./icons";

type Retry = (options: Options) => void;

interface Props {
  job: Job;
  unit: Unit;
  heading: "h1" | "h2";
  /** Submits another job with other options, if the user may. */
  retry?: Retry;
  /** Content directly below the heading. */
  children?: ComponentChildren;
}

/** The verdict and a summary of the repair. */
export function Verdict({ job, unit, heading: Heading, retry, children }: Props) {
  const { words, figures } = useWords();
  const report = job.report?.mode === "repair" ? job.report : null;
  const claims = claimsOf(job);
  const good = claims.isPrintable;
  const left = report && !good ? remainingDefects(report, words, figures) : "";
  return (
    <section class={`verdict ${claims.tone}`}>
      <p class="file-name">{job.input.name}</p>
      <Heading>
        <span class="seal">
          <Icon name={good ? "check" : "warn"} size={22} />
        </span>
        {words.outcomes[claims.title]}
      </Heading>
      {children}
      {report && isOpenSheet(report) && <p>{words.openSurface}</p>}
      {report && !claims.isRefused && (
        <ul class="deeds">
          {repairSummary(report, words, figures, unit).map((line) => (
            <li key={line}>{line}</li>
          ))}
        </ul>
      )}
      {left && <p class="left">{words.left(left)}</p>}
      {claims.proven.length > 0 && <p class="proof">{words.proven(claims.proven.map((property) => words.properties[property] ?? property).join(", "))}</p>}
      {report && <Remarks job={job} report={report} unit={unit} retry={retry} />}
      {job.reused_from && <p class="aside">{words.reused}</p>}
    </section>
  );
}

/** What the user should check: red flags, assumptions and other notes of the service. */
function Remarks({ job, report, unit, retry }: { job: Job; report: Report; unit: Unit; retry: Retry | undefined }) {
  const { words, figures } = useWords();
  const warnings = warningsOf(report, claimsOf(job).isPrintable, words, figures, unit);
  const assumptions = assumptionsOf(report, words, figures, unit);
  const notes = notesOf(report, words);
  return (
    <>
      {warnings.length > 0 && (
        <div class="flags">
          <p>{words.flags}</p>
          <ul>
            {warnings.map((remark) => (
              <RemarkLine key={remark.key} remark={remark} />
            ))}
          </ul>
        </div>
      )}
      {assumptions.length > 0 && (
        <div class="assumptions">
          <p>{words.assumptions}</p>
          <ul>
            {assumptions.map((remark) => (
              <RemarkLine key={remark.key} remark={remark} retry={retry && ((option) => retry(withOption(optionsOf(job), option)))} />
            ))}
          </ul>
        </div>
      )}
      {notes.length > 0 && (
        <details class="warnings" open={notes.length <= 2}>
          <summary>{words.notes(figures.count(notes.length), notes.length)}</summary>
          <ul>
            {notes.map((remark) => (
              <RemarkLine key={remark.key} remark={remark} />
            ))}
          </ul>
        </details>
      )}
    </>
  );
}

/** Options that have a separate form on the page. */
const HAS_FORM = /^(unit|open_sheets)=/;

function RemarkLine({ remark: { text, isEnglish, option }, retry }: { remark: Remark; retry?: ((option: string) => void) | undefined }) {
  const { words } = useWords();
  return (
    <li>
      <span {...(isEnglish && { lang: "en" })}>{text}</span>{" "}
      {option && retry && !HAS_FORM.test(option) && (
        <button type="button" class="link" title={words.decideOtherwiseWith(option)} onClick={() => retry(option)}>
          {words.decideOtherwise}
        </button>
      )}
    </li>
  );
}
