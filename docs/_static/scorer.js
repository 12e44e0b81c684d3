// Order of search results: how-to pages and the reference first, decision records and internals last.
var Scorer = {
  score: result => {
    const [name, , , , score] = result;
    if (/^(how-to\/|start|gallery|made\/python\/|made\/commands|made\/effects|reference)/.test(name)) return score + 20;
    if (/^(decisions\/|made\/api\/|made\/changelog|made\/tests|made\/benchmarks|made\/contributing)/.test(name)) return score - 30;
    return score;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
