// Questions to the posterior: a point, two points, a place in an image, a line of an image, a new intersection; and what
// to measure next, which the map then shows.

import {make} from './plot.js';

export class Questions {
  constructor(app, element) {
    Object.assign(this, {app, element});
    this.answers = make('div');
    this.points = make('input', {type: 'text', size: 30, placeholder: 'a point, or two: A, B'});
    this.image = make('select');
    this.line = make('input', {type: 'number', step: 'any', placeholder: 'line'});
    this.sample = make('input', {type: 'number', step: 'any', placeholder: 'sample'});
    this.pixels = [];
    this.list = make('ul');
    // Enter asks the first question of a row
    const row = (title, ...parts) => {
      const form = make('form', {}, make('fieldset', {}, make('legend', {textContent: title}), ...parts));
      form.addEventListener('submit', event => event.preventDefault());
      form.addEventListener('keydown', event => {
        if (event.key === 'Enter' && event.target.tagName === 'INPUT') form.querySelector('button').click();
      });
      return form;
    };
    const button = (textContent, act) => {
      const one = make('button', {type: 'button', textContent});
      one.addEventListener('click', act);
      return one;
    };
    element.replaceChildren(
      make('div', {className: 'tools'},
        row('Ground points', this.points, button('How well known?', () => this.askPoints()), button('Is the height difference real?', () => this.askPair())),
        row('Place in an image', make('label', {}, 'image ', this.image), make('label', {}, 'line ', this.line), make('label', {}, 'sample ', this.sample),
          button('Orientation at this line', () => this.askPose()),
          button('Where is the selected point?', () => this.ask({projections: [[app.selection, this.image.value]]})),
          button('Add as a ray', () => this.add()), button('Intersect the rays', () => this.ask({pixels: this.pixels}))),
        row('Next', button('What should I measure next?', () => this.plan()))),
      this.list, this.answers);
    app.addEventListener('opened', () => this.open());
    app.addEventListener('selected', () => this.take());
    app.addEventListener('placed', () => this.takePlace());
    if (app.scene) this.open();
    this.take();
    this.takePlace();
  }

  open() {
    this.image.replaceChildren(...this.app.scene.images.map(one => make('option', {value: one.name, textContent: one.name})));
  }

  // The last selected points stand in the field: two of them for a difference
  take() {
    const name = this.app.selection;
    if (!name) return;
    const [last] = this.names().slice(-1);
    this.points.value = last && last !== name ? `${last}, ${name}` : name;
  }

  // The place of an image that was clicked last
  takePlace() {
    if (!this.app.placed) return;
    const {image, line, sample} = this.app.placed;
    [this.image.value, this.line.value, this.sample.value] = [image, line.toFixed(2), sample.toFixed(2)];
  }

  names() {
    return this.points.value.split(',').map(one => one.trim()).filter(Boolean);
  }

  number(input) {
    return input.value === '' ? NaN : Number(input.value);
  }

  askPoints() {
    if (!this.names().length) return this.app.say('Name a point (or select one on the map).', 'error');
    return this.ask({points: this.names(), correlations: this.names().length > 1});
  }

  askPair() {
    const names = this.names();
    if (names.length !== 2) return this.app.say('Name two points, with a comma between them (or select two on the map).', 'error');
    return this.ask({pairs: [names]});
  }

  askPose() {
    if (Number.isNaN(this.number(this.line))) return this.app.say('Say the line.', 'error');
    return this.ask({poses: [[this.image.value, this.number(this.line)]]});
  }

  add() {
    const place = {image: this.image.value, line: this.number(this.line), sample: this.number(this.sample)};
    if (Number.isNaN(place.line) || Number.isNaN(place.sample)) return this.app.say('Say line and sample of the place.', 'error');
    this.pixels.push(place);
    return this.listRays();
  }

  listRays() {
    this.list.replaceChildren(...this.pixels.map(one => {
      const away = make('button', {type: 'button', textContent: '×', title: `Take the ray of ${one.image} away`});
      away.addEventListener('click', () => {
        this.pixels.splice(this.pixels.indexOf(one), 1);
        this.listRays();
      });
      return make('li', {}, `${one.image}: line ${one.line}, sample ${one.sample} `, away);
    }));
  }

  async ask(body) {
    try {
      const found = await this.app.request('/api/questions', body);
      this.answers.prepend(...found.map(one => make('pre', {textContent: one.text})));
      this.app.say('');
    } catch (error) {
      this.app.say(error.message, 'error');
    }
  }

  async plan() {
    this.app.say('Candidates are being judged …');
    try {
      const {sentence, candidates} = await this.app.request('/api/plan');
      const list = make('ol');
      for (const one of candidates) list.append(make('li', {textContent: one.text}));
      const show = make('button', {type: 'button', textContent: 'Show them on the map'});
      show.addEventListener('click', () => this.app.show('map'));
      this.answers.prepend(make('p', {textContent: sentence}), list, show);
      this.app.emit('candidates', candidates);
      this.app.say('The map marks them by squares with numbers.');
    } catch (error) {
      this.app.say(error.message, 'error');
    }
  }
}

export function panel(app, element) {
  element.view = new Questions(app, element);
  return element.view;
}
