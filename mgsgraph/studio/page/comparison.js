// Two solutions: what is open against other results, in the words and tables of `mgsgraph compare`, and on a map.

import {axes, make, palette, short} from './plot.js';

export class Comparison {
  constructor(app, element) {
    Object.assign(this, {app, element});
    this.other = make('input', {type: 'text', size: 40, placeholder: 'folder of other results'});
    this.other.setAttribute('list', 'other-solutions');
    this.known = make('datalist', {id: 'other-solutions'});
    const form = make('form', {className: 'tools'}, make('label', {}, 'Compare with ', this.other), this.known, make('button', {type: 'submit', textContent: 'Compare'}));
    form.addEventListener('submit', event => { event.preventDefault(); this.compare(); });
    this.found = make('div');
    element.replaceChildren(form, this.found);
    app.addEventListener('changed', () => this.offer());
    app.addEventListener('shown', event => { if (event.detail === 'comparison' && this.record) this.draw(); });
    this.offer();
  }

  async offer() {
    try {
      const {solutions} = await this.app.request('/api/compare');
      this.known.replaceChildren(...solutions.map(value => make('option', {value})));
      if (!this.other.value && solutions.length) this.other.value = solutions[solutions.length - 1];
    } catch (error) {
      this.app.say(error.message, 'error');
    }
  }

  async compare() {
    if (!this.other.value) return this.app.say('Name the folder of the other results.', 'error');
    try {
      this.record = await this.app.request(`/api/compare?${new URLSearchParams({other: this.other.value})}`);
    } catch (error) {
      return this.app.say(error.message, 'error');
    }
    this.app.say('');
    const {sentences, tables} = this.record, list = make('ul');
    list.append(...sentences.map(textContent => make('li', {textContent})));
    this.canvases = [['how far points moved horizontally (m)', one => Math.hypot(one.moved[0], one.moved[1]), false],
      ['how far points moved upward (m)', one => one.moved[2], true],
      ['3-D sigma over the other solution’s, logarithm of base 2', one => (one.ratio === null ? null : Math.log2(one.ratio)), true, 0.05]].map(([title, of, signed, least = 0]) => {
      const canvas = make('canvas', {className: 'diagram'});
      canvas.style.height = '300px';
      canvas.style.width = '100%';
      canvas.setAttribute('role', 'img');
      const words = make('p', {className: 'caption'});
      return {canvas, of, signed, title, words, least, figure: make('figure', {}, canvas, words)};
    });
    this.found.replaceChildren(list, make('div', {className: 'diagram-row'}, ...this.canvases.map(one => one.figure)), ...tables.map(table));
    this.draw();
    return undefined;
  }

  draw() {
    const {names, places, moved, ratio} = this.record;
    if (!places.length) return;
    const points = names.map((name, k) => ({name, place: places[k], moved: moved[k], ratio: ratio[k]}));
    const range = k => [Math.min(...places.map(one => one[k])) / 1000, Math.max(...places.map(one => one[k])) / 1000];
    const [x, y] = [range(0), range(1)].map(([a, b]) => [a - 0.05 * (b - a || 1), b + 0.05 * (b - a || 1)]);
    for (const {canvas, of, signed, title, words, least} of this.canvases) {
      const values = points.map(of), known = values.filter(one => one !== null).map(Math.abs).sort((a, b) => a - b);
      const most = Math.max(known[Math.floor(0.98 * (known.length - 1))] || 1, least), colours = palette(signed);
      const drawn = axes(canvas, {x, y, xLabel: 'km east', yLabel: 'km north', equal: true});
      points.forEach((one, k) => {
        if (values[k] === null) return;
        const share = signed ? 0.5 + 0.5 * values[k] / most : values[k] / most;
        drawn.context.fillStyle = colours[Math.min(Math.max(Math.floor(64 * share), 0), 63)];
        drawn.context.fillRect(drawn.toX(one.place[0] / 1000) - 2.5, drawn.toY(one.place[1] / 1000) - 2.5, 5, 5);
      });
      const middle = known[Math.floor(known.length / 2)];
      words.textContent = `${points.length} common points: ${title}; ${signed ? `blue −${short(most)} to red ${short(most)}` : `dark 0 to yellow ${short(most)}`}, half of them within ${short(middle)}.`;
      canvas.setAttribute('aria-label', words.textContent);
    }
  }
}

export function table({title, note, headings, rows}) {
  const head = make('tr');
  headings.forEach(([name, unit]) => head.append(make('th', {scope: 'col'}, name, unit ? make('small', {textContent: unit}) : '')));
  const body = make('tbody');
  for (const row of rows.slice(0, 100)) body.append(make('tr', {}, ...row.map(textContent => make('td', {textContent, className: textContent !== '' && !Number.isNaN(Number(textContent)) ? 'number' : ''}))));
  const scroll = make('div', {className: 'scroll', tabIndex: 0}, make('table', {}, make('thead', {}, head), body));
  const cut = rows.length > 100 ? ` The first 100 of ${rows.length} rows.` : '';
  return make('section', {}, make('h3', {textContent: title}), make('p', {className: 'caption', textContent: `${note}${cut}`}), scroll);
}

export function panel(app, element) {
  element.view = new Comparison(app, element);
  return element.view;
}
