import { useLayoutEffect, useMemo } from "preact/hooks";
import { route } from "../state/route";
import { known } from "../state/server";
import { settings } from "../state/settings";
import { PageSpoken, pageSpeech, usePageWords } from "../words/page-words";
import { Spoken } from "../words/words";
import { AskForKey, Away } from "./gate";
import { Header } from "./header";
import { JobPage } from "./job";
import { JobsPage } from "./jobs";
import { RepairPage } from "./repair";
import { useStore } from "./use-store";

/** The page in the chosen language. */
export function Page() {
  const { language } = useStore(settings);
  const said = useMemo(() => pageSpeech(language), [language]);
  return (
    <Spoken.Provider value={said}>
      <PageSpoken.Provider value={said}>
        <App />
      </PageSpoken.Provider>
    </Spoken.Provider>
  );
}

function App() {
  const { words } = usePageWords();
  const { language, theme } = useStore(settings);
  useLayoutEffect(() => {
    document.documentElement.lang = language;
    document.title = words.title;
  }, [language, words]);
  useLayoutEffect(() => {
    if (theme === "auto") document.documentElement.removeAttribute("data-theme");
    else document.documentElement.dataset["theme"] = theme;
  }, [theme]);
  return (
    <>
      <a class="skip" href="#main" onClick={toMain}>
        {words.skip}
      </a>
      <Header />
      <main id="main" tabIndex={-1}>
        <Content />
      </main>
    </>
  );
}

/** The page uses the part after # for its views, so a normal link to an anchor would change the view. */
function toMain(event: Event): void {
  event.preventDefault();
  document.getElementById("main")?.focus();
}

function Content() {
  const service = useStore(known);
  const where = useStore(route);
  if (service.is === "locked") return <AskForKey refused={service.refused} />;
  if (service.is === "away") return <Away problem={service.problem} />;
  const can = service.is === "ready" ? service.can : null;
  if (where.at === "jobs") return <JobsPage can={can} />;
  if (where.at === "job") return <JobPage id={where.id} can={can} />;
  return <RepairPage job={where.job} can={can} />;
}
