// Pages of the manual rank above generated ones, above experiments, and above names of the interface.
// Pages that fit equally stand in the order of the contents, PAGES.
const LATER = /^(reference|experiments|contributing|generalist_card)/;
var Scorer = {
  score: ([page, title, anchor, description, score]) =>
    score - (LATER.test(page) ? 50 : 0) - Math.max(0, PAGES.indexOf(page)) / 1000,
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
