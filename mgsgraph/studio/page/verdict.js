// The verdict of the adjustment: its state in the head of the page, its reasons with what they are about.

import {button, caption, make} from './plot.js';

const WORDS = {valid: 'valid', suspect: 'SUSPECT', invalid: 'INVALID', 'not adjusted': 'not adjusted', 'not tested': 'not tested'};
const VIEWS = {point: 'point', image: 'images', profile: 'map'};

export class Verdict {
  constructor(app, badge) {
    Object.assign(this, {app, badge, revision: null, found: null});
  }

  // The tests take seconds: once for each state of the block
  async read() {
    const {app, badge} = this, {revision} = app.scene;
    if (this.revision === revision) return;
    Object.assign(this, {revision, found: null});
    Object.assign(badge, {hidden: false, textContent: 'testing …', title: 'The adjustment is being tested'});
    badge.dataset.state = '';
    await app.request('/api/worst').catch(() => null); // the first screen does not wait for the tests
    const found = await app.request('/api/verdict').catch(error => ({state: 'not tested', reasons: [], sentences: [error.message]}));
    if (app.scene.revision !== revision) return;
    this.found = found;
    Object.assign(badge, {textContent: WORDS[found.state], title: 'Verdict of the adjustment: its reasons (v)'});
    badge.dataset.state = found.state;
    app.emit('judged');
  }

  parts(open = false) {
    if (!this.found) return make('p', {textContent: 'The adjustment is being tested …'});
    const {state, reasons, sentences} = this.found;
    const go = one => event => { event.target.closest('dialog')?.close(); this.app.look(one, VIEWS[one.kind]); };
    const link = one => button(one.name, go(one), {title: `Show ${one.kind} ${one.name}`});
    return make('div', {className: 'verdict'}, make('p', {}, make('strong', {textContent: `The adjustment is ${WORDS[state]}`}), reasons.length ? ':' : '.'),
      make('ul', {}, ...reasons.map(({sentence, links}) => make('li', {}, sentence, ' ', make('span', {className: 'links'}, ...links.map(link))))),
      make('details', {open: open || state.startsWith('not')}, make('summary', {textContent: 'What was tested, and what no test shows'}), ...sentences.map(caption)));
  }
}
