// Pages of the manual rank above generated ones, above experiments, and above names of the interface.
const LATER = /^(reference|experiments|contributing|generalist_card)/;
var Scorer = {
  score: ([page, title, anchor, description, score]) => score - (LATER.test(page) ? 50 : 0),
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
