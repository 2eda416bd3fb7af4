import { useLayoutEffect, useMemo } from "preact/hooks";
import { route } from "../state/route";
import { serviceState } from "../state/server";
import { settings } from "../state/settings";
import { PageLocaleContext, pageLocaleOf, usePageWords } from "../words/page-locale";
import { LocaleContext } from "../words/locale";
import { AskForKey, Away } from "./gate";
import { Header } from "./header";
import { JobPage } from "./job";
import { JobsPage } from "./jobs";
import { RepairPage } from "./repair";
import { useStore } from "./use-store";

/** The page in the chosen language. */
export function Page() {
  const { language } = useStore(settings);
  const said = useMemo(() => pageLocaleOf(language), [language]);
  return (
    <LocaleContext.Provider value={said}>
      <PageLocaleContext.Provider value={said}>
        <App />
      </PageLocaleContext.Provider>
    </LocaleContext.Provider>
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
  const service = useStore(serviceState);
  const where = useStore(route);
  if (service.is === "locked") return <AskForKey refused={service.refused} />;
  if (service.is === "away") return <Away problem={service.problem} />;
  const can = service.is === "ready" ? service.can : null;
  if (where.at === "jobs") return <JobsPage can={can} />;
  if (where.at === "job") return <JobPage id={where.id} can={can} />;
  return <RepairPage job={where.job} can={can} />;
}
