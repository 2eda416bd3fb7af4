import type { ComponentChildren } from "preact";
import type { Job, Options, PrintReadiness, RuleResult } from "meshmend-client";
import { mendingOptions, ruleValue, sortedRules } from "../report/print-ready";
import { useWords } from "../words/locale";
import { Icon } from "./icons";

/** A button that shows points, given in the file's unit, in the viewer; nothing for no points. */
export type GoTo = (name: string, points: number[][]) => ComponentChildren;

interface Props {
  job: Job;
  readiness: PrintReadiness;
  heading?: "h2" | "h3";
  /** The name of the file, if the job has several. */
  name?: string | undefined;
  /** Submits another job with other options, if the user may. */
  retry?: ((options: Options) => void) | undefined;
  /** Whether the user may set an option; without it, all. */
  maySet?: ((option: string) => boolean) | undefined;
  /** Shows places in the viewer, where there is one. */
  goTo?: GoTo | undefined;
}

/** Whether the file meets each rule of the process: limit, measured value, and what to do. */
export function PrintReady({ job, readiness, heading: Heading = "h2", name, retry, maySet, goTo }: Props) {
  const { words, figures } = useWords();
  const rules = sortedRules(readiness);
  const count = (result: RuleResult["result"]): number => rules.filter((rule) => rule.result === result).length;
  const [failed, undecided] = [count("fail"), count("undecided")];
  return (
    <section class={readiness.ready ? "print-ready good" : "print-ready"}>
      <Heading>{name ? `${words.printReady}: ${name}` : words.printReady}</Heading>
      <p role="status">
        <Icon name={readiness.ready ? "check" : "warn"} size={18} /> {readiness.ready && words.readyFor(readiness.title)}
        {failed > 0 && words.notReadyFor(readiness.title, failed)} {undecided > 0 && words.undecidedRules(undecided)}
      </p>
      <div class="table">
        <table class="rules">
          <thead>
            <tr>
              <th scope="col">{words.rule}</th>
              <th scope="col">{words.ruleResult}</th>
              <th scope="col">{words.limit}</th>
              <th scope="col">{words.measured}</th>
              <th scope="col">{words.remedy}</th>
            </tr>
          </thead>
          <tbody>
            {rules.map((rule) => (
              <Row key={rule.rule} rule={rule} options={mendingOptions(job, rule, maySet)} retry={retry} places={goTo?.(words.rules[rule.rule] ?? rule.rule, (rule.places ?? []).map(({ at }) => at))} />
            ))}
          </tbody>
        </table>
      </div>
      <p class="aside">{figures.count(rules.length - failed - undecided)} / {figures.count(rules.length)}</p>
      <Hollows readiness={readiness} goTo={goTo} />
    </section>
  );
}

/** The sealed cavities, and the resin cups in the model's orientation. Neither breaks a rule by itself. */
function Hollows({ readiness: { cavities = [], cups = [] }, goTo }: Pick<Props, "readiness" | "goTo">) {
  const { words, figures } = useWords();
  const volume = (mm3: number): string => `${figures.number(mm3, 3)} mm³`;
  const lists = [
    { name: words.cavities, hollows: cavities, largest: words.largestCavity, advice: null },
    { name: words.resinCups, hollows: cups, largest: words.largestCup, advice: words.resinCupAdvice },
  ];
  return (
    <>
      {lists.map(({ name, hollows, largest, advice }) => {
        const [first] = hollows;
        if (!first) return null;
        const points = hollows.map(({ at }) => at);
        return (
          <p key={name}>
            <b>{name}: {figures.count(hollows.length)}.</b> {largest(volume(first.volume_mm3))} {advice} {goTo?.(name, points)}
          </p>
        );
      })}
    </>
  );
}

interface RowProps {
  rule: RuleResult;
  /** The options of a job that mends the rule. */
  options: Options | null;
  retry: ((options: Options) => void) | undefined;
  places: ComponentChildren;
}

function Row({ rule: { rule, result, severity, limit, measured, count, remedy }, options, retry, places }: RowProps) {
  const { words, figures } = useWords();
  const tell = words.remedies[rule];
  return (
    <tr class={result}>
      <th scope="row">{words.rules[rule] ?? rule}</th>
      <td>
        <span class={`chip ${result === "pass" ? "good" : result === "fail" ? "bad" : "fair"}`} title={severity ? words.severities[severity] : undefined}>
          {words.ruleResults[result]}
        </span>{" "}
        {count > 1 && words.rulePlaces(figures.count(count))} {places}
      </td>
      <td data-name={words.limit}>{ruleValue(rule, limit, figures)}</td>
      <td data-name={words.measured}>{ruleValue(rule, measured, figures)}</td>
      <td>
        {result === "fail" && (tell ? tell(ruleValue(rule, limit, figures)) : <span lang="en">{remedy}</span>)}{" "}
        {options && retry && (
          <button type="button" class="link" onClick={() => retry(options)}>
            {words.mendRule}
          </button>
        )}
      </td>
    </tr>
  );
}
