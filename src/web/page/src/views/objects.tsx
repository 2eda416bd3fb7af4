import type { ObjectReport } from "meshmend-client";
import { repairSummary } from "../report/summary";
import { settings } from "../state/settings";
import { usePageWords } from "../words/page-locale";
import { OutcomeChip } from "./chips";
import { useStore } from "./use-store";

/** The outcome for each object of a file with several objects. */
export function Objects({ objects }: { objects: ObjectReport[] }) {
  const { words, figures } = usePageWords();
  const { unit } = useStore(settings);
  return (
    <details class="numbers card" open>
      <summary>{words.objects(figures.count(objects.length))}</summary>
      <div class="scroll">
        <table>
          <thead>
            <tr>
              <th scope="col">{words.object}</th>
              <th scope="col">{words.status}</th>
              <th scope="col">{words.changesTitle}</th>
              <th scope="col">{words.measures.faces}</th>
            </tr>
          </thead>
          <tbody>
            {objects.map((it) => (
              <tr key={it.number}>
                <th scope="row">
                  {it.name || figures.count(it.number)}
                  {it.places > 1 && <span class="aside"> × {figures.count(it.places)}</span>}
                </th>
                <td>
                  <OutcomeChip outcome={it.outcome} />
                </td>
                <td>{repairSummary(it, words, figures, unit).join(", ")}</td>
                <td>
                  {figures.count(it.before.faces)}
                  {it.after && it.after.faces !== it.before.faces && ` → ${figures.count(it.after.faces)}`}
                </td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
    </details>
  );
}
