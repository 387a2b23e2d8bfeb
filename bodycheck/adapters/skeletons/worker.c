/* The engine `example` as a worker of bodycheck: replace `advance`, and what it needs, by your engine.
 *     cc -O2 -o example example.c -lm && bodycheck check-adapter cmd:./example
 * A request is searched for its keys instead of parsed: they are unique in a scene without loads and link. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct { double position[3], velocity[3], quaternion[4], omega[3]; } State; /* omega in body axes */
typedef struct {
    double mass, inertia[3][3], inverse[3][3], gravity[3], duration_s, samples, dt_s, steps; /* per sample */
    State start;
} Case;

static int numbers(const char *text, const char *key, double *values, int n) {
    const char *at = strstr(text, key);
    char *end = NULL;
    for (at = at ? at + strlen(key) : NULL; at && n > 0; n--, at = end == at ? NULL : end) {
        at += strspn(at, " [],:");
        *values++ = strtod(at, &end);
    }
    return n == 0;
}

/* Read a case; return NULL, or why it cannot be run. */
static const char *read_case(const char *line, Case *c) {
    if (!strstr(line, "\"method\":\"euler\"")) return "only the method euler";
    if (!strstr(line, "\"loads\":[]") || strstr(line, "\"pivot\":") || strstr(line, "\"link\":"))
        return "only gravity: no loads, pivot or link frame";
    if (!numbers(line, "\"mass\":", &c->mass, 1) || !numbers(line, "\"inertia\":", &c->inertia[0][0], 9) ||
        !numbers(line, "\"position\":", c->start.position, 3) || !numbers(line, "\"dt_s\":", &c->dt_s, 1) ||
        !numbers(line, "\"velocity\":", c->start.velocity, 3) || !numbers(line, "\"gravity\":", c->gravity, 3) ||
        !numbers(line, "\"quaternion\":", c->start.quaternion, 4) || !numbers(line, "\"samples\":", &c->samples, 1) ||
        !numbers(line, "\"omega_body\":", c->start.omega, 3) || !numbers(line, "\"duration_s\":", &c->duration_s, 1))
        return "a case without all its numbers";
    c->steps = round(c->duration_s / (c->samples - 1.0) / c->dt_s);
    c->dt_s = c->duration_s / (c->steps * (c->samples - 1.0));
    double (*m)[3] = c->inertia, det = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0, k = (i + 1) % 3, l = (i + 2) % 3; j < 3; j++)
            c->inverse[j][i] = m[k][(j + 1) % 3] * m[l][(j + 2) % 3] - m[k][(j + 2) % 3] * m[l][(j + 1) % 3];
    for (int j = 0; j < 3; j++) det += m[0][j] * c->inverse[j][0];
    for (int i = 0; i < 9; i++) (&c->inverse[0][0])[i] /= det;
    return NULL;
}

/* The engine, explicit Euler: omega += h I^-1 (-omega x I omega); q += h/2 q omega; x += h v; v += h g. */
static void advance(const Case *c, State *s) {
    const double h = c->dt_s, *q = s->quaternion, *w = s->omega;
    double l[3] = {0};
    for (int i = 0; i < 9; i++) l[i / 3] += c->inertia[i / 3][i % 3] * w[i % 3];
    const double torque[3] = {l[1] * w[2] - l[2] * w[1], l[2] * w[0] - l[0] * w[2], l[0] * w[1] - l[1] * w[0]};
    const double turned[4] = {q[0] - 0.5 * h * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2]),
                              q[1] + 0.5 * h * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]),
                              q[2] + 0.5 * h * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2]),
                              q[3] + 0.5 * h * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0])};
    memcpy(s->quaternion, turned, sizeof turned);
    for (int i = 0; i < 9; i++) s->omega[i / 3] += h * c->inverse[i / 3][i % 3] * torque[i % 3];
    for (int i = 0; i < 3; i++) s->position[i] += h * s->velocity[i], s->velocity[i] += h * c->gravity[i];
}

static void print_numbers(const char *key, const double *values, int n) {
    printf("%s[", key);
    for (int i = 0; i < n; i++) printf(isfinite(values[i]) ? "%s%.17g" : "%snull", i ? "," : "", values[i]);
    printf("]");
}

static void print_state(const char *before, const State *s) {
    print_numbers(before, s->position, 3);
    print_numbers(",\"velocity\":", s->velocity, 3);
    print_numbers(",\"quaternion\":", s->quaternion, 4);
    print_numbers(",\"omega_body\":", s->omega, 3);
    printf("}");
}

/* Make all steps from the start, and print the state at each sample; return the last one. */
static State run(const Case *c, int printed) {
    State s = c->start;
    for (int k = 0; k < c->samples; k++) {
        for (int i = 0; k && i < c->steps; i++) advance(c, &s);
        if (printed) print_state(k ? ",{\"position\":" : "\"trajectory\":[{\"position\":", &s);
    }
    return s;
}

int main(void) {
    Case asked, prepared = {0};
    char *line = NULL; size_t room = 0;
    printf("{\"bodycheck\":1,\"engine\":\"example\",\"version\":\"0.1.0\",\"methods\":[{\"name\":\"euler\","
           "\"formula\":\"explicit Euler\",\"order\":1,\"evaluations\":1,\"torque\":\"zero-order hold\","
           "\"conserves\":\"nothing\",\"source\":\"its manual\"}],\"limits\":{\"message_bytes\":1048576}}\n");
    for (fflush(stdout); getline(&line, &room, stdin) > 0; fflush(stdout)) {
        double id = NAN;
        char what[16] = "";
        numbers(line, "\"id\":", &id, 1);
        sscanf(strstr(line, "\"do\":\"") ? strstr(line, "\"do\":\"") + 6 : "", "%15[^\"]", what);
        const int again = !strcmp(what, "replay"), prepare = !strcmp(what, "prepare"), lap = !strcmp(what, "lap");
        const int record = again || !strcmp(what, "record");
        const char *refusal = record || prepare ? read_case(line, &asked) : lap ? NULL : "no such request";
        const char *why_not = record || prepare || !strcmp(what, "stable-step") ? "unsupported" : "failed";
        printf(isnan(id) ? "{\"id\":null," : "{\"id\":%.0f,", id);
        if (record && !refusal) {
            const State held = again ? run(&asked, 0) : asked.start; /* what the engine holds before its reset */
            run(&asked, 1);
            printf("],\"read_back\":{\"mass\":%.17g,\"dt_s\":%.17g", asked.mass, asked.dt_s);
            for (int i = 0; i < 3; i++) print_numbers(i ? "," : ",\"inertia\":[", asked.inertia[i], 3);
            print_numbers("],\"gravity\":", asked.gravity, 3);
            print_state(",\"state\":{\"position\":", &held), printf("},");
        } else if (!refusal) {
            if (prepare) prepared = asked;
            const clock_t begin = clock();
            volatile double used = run(&prepared, 0).omega[0]; /* or the compiler would leave the steps out */
            (void)used;
            printf("\"cpu_s\":%.9g,", (double)(clock() - begin) / CLOCKS_PER_SEC);
        }
        printf("\"outcome\":\"%s\",\"message\":\"%s\"}\n", refusal ? why_not : "ok", refusal ? refusal : "");
    }
}
