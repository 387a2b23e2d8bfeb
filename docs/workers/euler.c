/* A worker for bodycheck in C: Euler's equations by the explicit Euler method, for a free body without loads.
 *
 *     cc -O2 -o euler euler.c -lm
 *     bodycheck run intermediate-axis --engine "cmd:./euler"
 *
 * It searches the request for the keys it needs instead of parsing it, which the protocol permits: keys are
 * unique in a request without loads, and numbers are in JSON's decimal form.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct {
    double mass, inertia[3][3], inverse[3][3];
    double position[3], velocity[3], quaternion[4], omega[3];
    double duration, step;
    long samples, steps; /* steps: from one sample to the next */
    int supported;
} Case;

static const char *after(const char *text, const char *key) {
    const char *found = strstr(text, key);
    return found ? found + strlen(key) : NULL;
}

/* Read n numbers after a key; brackets and commas between them are skipped. Return whether all are there. */
static int numbers(const char *text, const char *key, double *values, int n) {
    const char *at = after(text, key);
    for (int i = 0; at && i < n; i++) {
        char *end;
        at += strspn(at, " [],:");
        values[i] = strtod(at, &end);
        at = end == at ? NULL : end;
    }
    return at != NULL;
}

static void invert(double m[3][3], double out[3][3]) {
    double det = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
            out[j][i] = m[a][c] * m[b][d] - m[a][d] * m[b][c];
        }
    for (int j = 0; j < 3; j++) det += m[0][j] * out[j][0];
    for (int i = 0; i < 9; i++) (&out[0][0])[i] /= det;
}

static int read_case(const char *line, Case *c) {
    double gravity[3], samples, dt;
    int whole = numbers(line, "\"mass\":", &c->mass, 1) && numbers(line, "\"inertia\":", &c->inertia[0][0], 9) &&
                numbers(line, "\"position\":", c->position, 3) && numbers(line, "\"velocity\":", c->velocity, 3) &&
                numbers(line, "\"quaternion\":", c->quaternion, 4) && numbers(line, "\"omega_body\":", c->omega, 3) &&
                numbers(line, "\"gravity\":", gravity, 3) && numbers(line, "\"duration_s\":", &c->duration, 1) &&
                numbers(line, "\"samples\":", &samples, 1) && numbers(line, "\"dt_s\":", &dt, 1);
    const char *loads = after(line, "\"loads\":");
    if (!whole || !loads) return 0;
    loads += strspn(loads, " ");
    c->supported = strspn(loads + 1, " ") + 1 == strcspn(loads, "]") && !strstr(line, "\"pivot\"") &&
                   !strstr(line, "\"link\"") && gravity[0] == 0.0 && gravity[1] == 0.0 && gravity[2] == 0.0;
    c->samples = (long)samples;
    c->steps = lround(c->duration / (samples - 1.0) / dt);
    c->step = c->duration / ((double)c->steps * (samples - 1.0));
    invert(c->inertia, c->inverse);
    return 1;
}

static void advance(Case *c) {
    const double h = c->step, *w = c->omega, *q = c->quaternion;
    double momentum[3] = {0}, change[3] = {0};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) momentum[i] += c->inertia[i][j] * w[j];
    double torque[3] = {w[2] * momentum[1] - w[1] * momentum[2], w[0] * momentum[2] - w[2] * momentum[0],
                        w[1] * momentum[0] - w[0] * momentum[1]};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) change[i] += c->inverse[i][j] * torque[j];
    double turned[4] = {q[0] - 0.5 * h * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2]),
                        q[1] + 0.5 * h * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]),
                        q[2] + 0.5 * h * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2]),
                        q[3] + 0.5 * h * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0])};
    for (int i = 0; i < 3; i++) {
        c->position[i] += h * c->velocity[i];
        c->omega[i] += h * change[i];
    }
    memcpy(c->quaternion, turned, sizeof turned);
}

/* Print an array as its shape and its little-endian doubles in base64. */
static void print_array(const char *name, const double *values, long rows, long columns) {
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const unsigned char *bytes = (const unsigned char *)values;
    size_t size = (size_t)(rows * (columns ? columns : 1)) * sizeof *values;
    printf("\"%s\":{\"shape\":[%ld", name, rows);
    if (columns) printf(",%ld", columns);
    printf("],\"base64\":\"");
    for (size_t i = 0; i < size; i += 3) {
        unsigned long word = (unsigned long)bytes[i] << 16;
        if (i + 1 < size) word |= (unsigned long)bytes[i + 1] << 8;
        if (i + 2 < size) word |= bytes[i + 2];
        putchar(digits[word >> 18]);
        putchar(digits[word >> 12 & 63]);
        putchar(i + 1 < size ? digits[word >> 6 & 63] : '=');
        putchar(i + 2 < size ? digits[word & 63] : '=');
    }
    printf("\"}");
}

static void record(const char *id, Case c) {
    const Case start = c;
    const double none[3] = {0.0, 0.0, 0.0};
    double *t = malloc(sizeof(double) * 14 * (size_t)c.samples);
    if (!t) {
        printf("{\"id\":%s,\"outcome\":\"failed\",\"message\":\"out of memory\"}\n", id);
        return;
    }
    double *x = t + c.samples, *v = x + 3 * c.samples, *q = v + 3 * c.samples, *w = q + 4 * c.samples;
    for (long k = 0; k < c.samples; k++) {
        for (long i = 0; k && i < c.steps; i++) advance(&c);
        t[k] = (double)k * c.duration / (double)(c.samples - 1);
        memcpy(x + 3 * k, c.position, sizeof c.position);
        memcpy(v + 3 * k, c.velocity, sizeof c.velocity);
        memcpy(q + 4 * k, c.quaternion, sizeof c.quaternion);
        memcpy(w + 3 * k, c.omega, sizeof c.omega);
    }
    printf("{\"id\":%s,\"outcome\":\"ok\",\"message\":\"\",\"stepping\":\"native\",\"steps\":null,\"trajectory\":{", id);
    print_array("t_s", t, c.samples, 0), putchar(',');
    print_array("position_m", x, c.samples, 3), putchar(',');
    print_array("velocity_m_s", v, c.samples, 3), putchar(',');
    print_array("quaternion", q, c.samples, 4), putchar(',');
    print_array("omega_body_rad_s", w, c.samples, 3);
    printf("},\"read_back\":{\"mass\":%.17g,\"dt_s\":%.17g,", start.mass, start.step);
    print_array("inertia", &start.inertia[0][0], 3, 3), putchar(',');
    print_array("gravity", none, 3, 0);
    printf(",\"state\":{");
    print_array("position", start.position, 3, 0), putchar(',');
    print_array("velocity", start.velocity, 3, 0), putchar(',');
    print_array("quaternion", start.quaternion, 4, 0), putchar(',');
    print_array("omega_body", start.omega, 3, 0);
    printf("}}}\n");
    free(t);
}

static void lap(const char *id, Case c) {
    clock_t begin = clock();
    for (long k = 1; k < c.samples; k++)
        for (long i = 0; i < c.steps; i++) advance(&c);
    double cpu = (double)(clock() - begin) / CLOCKS_PER_SEC;
    volatile double used = c.omega[0]; /* or the compiler would leave the steps out */
    (void)used;
    printf("{\"id\":%s,\"outcome\":\"ok\",\"cpu_s\":%.9g}\n", id, cpu);
}

int main(void) {
    Case prepared = {0}, asked;
    char *line = NULL, id[32];
    size_t room = 0;
    printf("{\"bodycheck\":1,\"engine\":\"euler-c\",\"version\":\"1\",\"methods\":[{\"name\":\"euler\","
           "\"formula\":\"omega += h I^-1 (-omega x I omega); q += h/2 q omega\",\"order\":1,\"evaluations\":1,"
           "\"torque\":\"zero-order hold\",\"conserves\":\"nothing\",\"source\":\"Euler (1768)\",\"control\":\"dt\","
           "\"changed_defaults\":[],\"tolerances\":[]}],\"limits\":{\"message_bytes\":536870912},\"build\":\"\"}\n");
    fflush(stdout);
    while (getline(&line, &room, stdin) > 0) {
        double number = 0.0;
        if (numbers(line, "\"id\":", &number, 1))
            snprintf(id, sizeof id, "%.0f", number);
        else
            strcpy(id, "null");
        int is_record = strstr(line, "\"do\":\"record\"") != NULL, is_prepare = strstr(line, "\"do\":\"prepare\"") != NULL;
        if (strstr(line, "\"do\":\"lap\"") && prepared.samples)
            lap(id, prepared);
        else if (strstr(line, "\"do\":\"stable-step\""))
            printf("{\"id\":%s,\"outcome\":\"unsupported\",\"message\":\"no search for the largest stable step\"}\n", id);
        else if (strstr(line, "\"do\":\"replay\""))
            printf("{\"id\":%s,\"outcome\":\"unsupported\",\"message\":\"no second run of a case\"}\n", id);
        else if (!(is_record || is_prepare) || !read_case(line, &asked))
            printf("{\"id\":%s,\"outcome\":\"failed\",\"message\":\"unexpected request\"}\n", id);
        else if (!strstr(line, "\"method\":\"euler\""))
            printf("{\"id\":%s,\"outcome\":\"unsupported\",\"message\":\"no such method\"}\n", id);
        else if (!asked.supported)
            printf("{\"id\":%s,\"outcome\":\"unsupported\",\"message\":\"only free bodies without loads\"}\n", id);
        else if (is_record)
            record(id, asked);
        else {
            prepared = asked;
            printf("{\"id\":%s,\"outcome\":\"ok\"}\n", id);
        }
        fflush(stdout);
    }
    free(line);
    return 0;
}
