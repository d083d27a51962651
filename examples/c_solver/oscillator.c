/* A solver as a program: the Bouc-Wen oscillator (n = 1) by classical Runge-Kutta.

   usage: oscillator input.txt record.txt response.csv
   input.txt   mass stiffness damping alpha beta gamma dt substeps, in SI
   record.txt  ground acceleration [m/s^2], a value a line
   response.csv  time, displacement, velocity                                    */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static double mass, stiffness, damping, alpha, beta, gamma_, dt;

static void slopes(const double s[3], double ground, double d[3])
{
    const double u = s[0], v = s[1], z = s[2];
    d[0] = v;
    d[1] = -ground - (damping * v + stiffness * (alpha * u + (1.0 - alpha) * z)) / mass;
    d[2] = v - beta * fabs(v) * z - gamma_ * v * fabs(z);
}

static void step(double s[3], double h, double a0, double a1)
{
    double k1[3], k2[3], k3[3], k4[3], t[3];
    const double am = 0.5 * (a0 + a1);
    int i;
    slopes(s, a0, k1);
    for (i = 0; i < 3; i++) t[i] = s[i] + 0.5 * h * k1[i];
    slopes(t, am, k2);
    for (i = 0; i < 3; i++) t[i] = s[i] + 0.5 * h * k2[i];
    slopes(t, am, k3);
    for (i = 0; i < 3; i++) t[i] = s[i] + h * k3[i];
    slopes(t, a1, k4);
    for (i = 0; i < 3; i++) s[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
}

int main(int argc, char **argv)
{
    FILE *input, *record, *response;
    double state[3] = {0.0, 0.0, 0.0}, now, next;
    int substeps, sample, j;
    if (argc != 4) { fprintf(stderr, "usage: oscillator input.txt record.txt response.csv\n"); return 2; }
    input = fopen(argv[1], "r");
    record = fopen(argv[2], "r");
    response = fopen(argv[3], "w");
    if (!input || !record || !response) { perror("oscillator"); return 2; }
    if (fscanf(input, "%lf %lf %lf %lf %lf %lf %lf %d", &mass, &stiffness, &damping, &alpha, &beta, &gamma_, &dt, &substeps) != 8) {
        fprintf(stderr, "input.txt: eight numbers are needed\n");
        return 2;
    }
    fprintf(response, "time,displacement,velocity\n");
    if (fscanf(record, "%lf", &now) != 1) { fprintf(stderr, "record.txt is empty\n"); return 2; }
    for (sample = 0;; sample++) {
        if (!isfinite(state[0])) { fprintf(stderr, "diverged at %g s\n", sample * dt); return 3; }
        fprintf(response, "%.17g,%.17g,%.17g\n", sample * dt, state[0], state[1]);
        if (fscanf(record, "%lf", &next) != 1) break;
        for (j = 0; j < substeps; j++)
            step(state, dt / substeps, now + (next - now) * j / substeps, now + (next - now) * (j + 1) / substeps);
        now = next;
    }
    return 0;
}
