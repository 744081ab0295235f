/* SPMe, parameter set Chen2020, generated with PyBaMM 26.10.1.1, CasADi 3.8.1: do not edit. */
#pragma GCC diagnostic ignored "-Wunused-parameter"
#include <math.h>
#define hypot(x, y) sqrt((x) * (x) + (y) * (y))
/* How to prefix internal symbols */
#ifdef CASADI_CODEGEN_PREFIX
  #define CASADI_NAMESPACE_CONCAT(NS, ID) _CASADI_NAMESPACE_CONCAT(NS, ID)
  #define _CASADI_NAMESPACE_CONCAT(NS, ID) NS ## ID
  #define CASADI_PREFIX(ID) CASADI_NAMESPACE_CONCAT(CODEGEN_PREFIX, ID)
#else
  #define CASADI_PREFIX(ID) cell_ ## ID
#endif

#include <math.h>

#ifndef casadi_real
#define casadi_real double
#endif

#ifndef casadi_int
#define casadi_int int
#endif

/* Add prefix to internal symbols */
#define casadi_f0 CASADI_PREFIX(f0)
#define casadi_f1 CASADI_PREFIX(f1)
#define casadi_f2 CASADI_PREFIX(f2)
#define casadi_f3 CASADI_PREFIX(f3)
#define casadi_fabs CASADI_PREFIX(fabs)
#define casadi_fmax CASADI_PREFIX(fmax)
#define casadi_fmin CASADI_PREFIX(fmin)
#define casadi_hypot CASADI_PREFIX(hypot)
#define casadi_s0 CASADI_PREFIX(s0)
#define casadi_s1 CASADI_PREFIX(s1)
#define casadi_s2 CASADI_PREFIX(s2)
#define casadi_s3 CASADI_PREFIX(s3)
#define casadi_sq CASADI_PREFIX(sq)

/* Symbol visibility in DLLs */
#ifndef CASADI_SYMBOL_EXPORT
  #if defined(_WIN32) || defined(__WIN32__) || defined(__CYGWIN__)
    #if defined(STATIC_LINKED)
      #define CASADI_SYMBOL_EXPORT
    #else
      #define CASADI_SYMBOL_EXPORT __declspec(dllexport)
    #endif
  #elif defined(__GNUC__) && defined(GCC_HASCLASSVISIBILITY)
    #define CASADI_SYMBOL_EXPORT __attribute__ ((visibility ("default")))
  #else
    #define CASADI_SYMBOL_EXPORT
  #endif
#endif

casadi_real casadi_fmax(casadi_real x, casadi_real y) {
/* Pre-c99 compatibility */
#if __STDC_VERSION__ < 199901L
  return x>y ? x : y;
#else
  return fmax(x, y);
#endif
}

casadi_real casadi_sq(casadi_real x) { return x*x;}

casadi_real casadi_hypot(casadi_real x, casadi_real y) {
/* Pre-c99 compatibility */
#if __STDC_VERSION__ < 199901L
  return sqrt(x*x+y*y);
#else
  return hypot(x, y);
#endif
}

casadi_real casadi_fmin(casadi_real x, casadi_real y) {
/* Pre-c99 compatibility */
#if __STDC_VERSION__ < 199901L
  return x<y ? x : y;
#else
  return fmin(x, y);
#endif
}

casadi_real casadi_fabs(casadi_real x) {
/* Pre-c99 compatibility */
#if __STDC_VERSION__ < 199901L
  return x>0 ? x : -x;
#else
  return fabs(x);
#endif
}

static const casadi_int casadi_s0[3] = {3, 1, 1};
static const casadi_int casadi_s1[3] = {26, 1, 1};
static const casadi_int casadi_s2[3] = {8, 1, 1};
static const casadi_int casadi_s3[3] = {1, 1, 1};

/* cell_initial:(i0[3])->(o0[26]) */
static int casadi_f0(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0, a1, a2;
  a0=2.6345790270645774e-02;
  a1=8.8427225638176377e-01;
  a2=arg[0]? arg[0][2] : 0;
  a1=(a1*a2);
  a0=(a0+a1);
  if (res[0]!=0) res[0][0]=a0;
  if (res[0]!=0) res[0][1]=a0;
  if (res[0]!=0) res[0][2]=a0;
  if (res[0]!=0) res[0][3]=a0;
  if (res[0]!=0) res[0][4]=a0;
  if (res[0]!=0) res[0][5]=a0;
  if (res[0]!=0) res[0][6]=a0;
  if (res[0]!=0) res[0][7]=a0;
  a0=8.5397467463004695e-01;
  a1=-5.9012945003871708e-01;
  a1=(a1*a2);
  a0=(a0+a1);
  if (res[0]!=0) res[0][8]=a0;
  if (res[0]!=0) res[0][9]=a0;
  if (res[0]!=0) res[0][10]=a0;
  if (res[0]!=0) res[0][11]=a0;
  if (res[0]!=0) res[0][12]=a0;
  if (res[0]!=0) res[0][13]=a0;
  if (res[0]!=0) res[0][14]=a0;
  if (res[0]!=0) res[0][15]=a0;
  a0=2.5000000000000000e-01;
  if (res[0]!=0) res[0][16]=a0;
  if (res[0]!=0) res[0][17]=a0;
  if (res[0]!=0) res[0][18]=a0;
  if (res[0]!=0) res[0][19]=a0;
  a0=4.6999999999999997e-01;
  if (res[0]!=0) res[0][20]=a0;
  a0=3.3500000000000002e-01;
  if (res[0]!=0) res[0][21]=a0;
  if (res[0]!=0) res[0][22]=a0;
  if (res[0]!=0) res[0][23]=a0;
  if (res[0]!=0) res[0][24]=a0;
  a0=3.3540164346805303e-03;
  a1=arg[0]? arg[0][1] : 0;
  a0=(a0*a1);
  if (res[0]!=0) res[0][25]=a0;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_initial(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f0(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int cell_initial_checkout(void) {
  return 0;
}

CASADI_SYMBOL_EXPORT void cell_initial_release(int mem) {
}

CASADI_SYMBOL_EXPORT void cell_initial_incref(void) {
}

CASADI_SYMBOL_EXPORT void cell_initial_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int cell_initial_n_in(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_int cell_initial_n_out(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_real cell_initial_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_initial_name_in(casadi_int i) {
  switch (i) {
    case 0: return "i0";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_initial_name_out(casadi_int i) {
  switch (i) {
    case 0: return "o0";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_initial_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s0;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_initial_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s1;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT int cell_initial_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 1;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_initial_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 1*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}

/* cell_rhs:(i0[26],i1[3])->(o0[26]) */
static int casadi_f1(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a00, a01, a02, a03, a04, a05, a06, a07, a08, a09, a10, a11;
  casadi_real a12, a13, a14, a15, a16, a17, a18, a19, a20, a21, a22, a23;
  casadi_real a24, a25, a26, a27, a28, a29, a30, a31, a32, a33, a34, a35;
  casadi_real a36, a37, a38, a39, a40, a41, a42, a43, a44, a45, a46, a47;
  casadi_real a48, a49, a50, a51, a52, a53, a54, a55, a56, a57, a58;
  a00=-3.1552715526435376e-02;
  a01=arg[0]? arg[0][0] : 0;
  a00=(a00*a01);
  a02=3.1552715526435376e-02;
  a03=arg[0]? arg[0][1] : 0;
  a02=(a02*a03);
  a00=(a00+a02);
  if (res[0]!=0) res[0][0]=a00;
  a00=8.2954437725222974e-03;
  a00=(a00*a01);
  a01=-4.2657500354702761e-02;
  a01=(a01*a03);
  a00=(a00+a01);
  a01=3.4362056582180459e-02;
  a02=arg[0]? arg[0][2] : 0;
  a01=(a01*a02);
  a00=(a00+a01);
  if (res[0]!=0) res[0][1]=a00;
  a00=2.4804282869393832e-02;
  a00=(a00*a03);
  a03=-8.3930093065355371e-02;
  a03=(a03*a02);
  a00=(a00+a03);
  a03=5.9125810195961540e-02;
  a01=arg[0]? arg[0][3] : 0;
  a03=(a03*a01);
  a00=(a00+a03);
  if (res[0]!=0) res[0][2]=a00;
  a00=5.9232776883695736e-02;
  a00=(a00*a02);
  a02=-1.7327466827811019e-01;
  a02=(a02*a01);
  a00=(a00+a02);
  a02=1.1404189139441445e-01;
  a03=arg[0]? arg[0][4] : 0;
  a02=(a02*a03);
  a00=(a00+a02);
  if (res[0]!=0) res[0][3]=a00;
  a00=1.3289699492851204e-01;
  a00=(a00*a01);
  a01=-3.6255511143286556e-01;
  a01=(a01*a03);
  a00=(a00+a01);
  a01=2.2965811650435355e-01;
  a02=arg[0]? arg[0][5] : 0;
  a01=(a01*a02);
  a00=(a00+a01);
  if (res[0]!=0) res[0][4]=a00;
  a00=2.9059766821209898e-01;
  a00=(a00*a03);
  a03=-7.6266980373167892e-01;
  a03=(a03*a02);
  a00=(a00+a03);
  a03=4.7207213551957988e-01;
  a01=arg[0]? arg[0][6] : 0;
  a03=(a03*a01);
  a00=(a00+a03);
  if (res[0]!=0) res[0][5]=a00;
  a00=6.2730376243716846e-01;
  a00=(a00*a02);
  a02=-1.6085184350658255e+00;
  a02=(a02*a01);
  a00=(a00+a02);
  a02=9.8121467262865691e-01;
  a03=arg[0]? arg[0][7] : 0;
  a02=(a02*a03);
  a00=(a00+a02);
  if (res[0]!=0) res[0][6]=a00;
  a00=1.3444293995446979e+00;
  a00=(a00*a01);
  a02=-1.3444293995446979e+00;
  a02=(a02*a03);
  a00=(a00+a02);
  a02=-6.8262329277067428e-04;
  a04=arg[1]? arg[1][0] : 0;
  a02=(a02*a04);
  a00=(a00+a02);
  if (res[0]!=0) res[0][7]=a00;
  a00=-4.8198888078903272e-03;
  a02=arg[0]? arg[0][8] : 0;
  a00=(a00*a02);
  a05=4.8198888078903272e-03;
  a06=arg[0]? arg[0][9] : 0;
  a05=(a05*a06);
  a00=(a00+a05);
  if (res[0]!=0) res[0][8]=a00;
  a00=1.2671846441288149e-03;
  a00=(a00*a02);
  a02=-6.5162191304881751e-03;
  a02=(a02*a06);
  a00=(a00+a02);
  a02=5.2490344863593595e-03;
  a05=arg[0]? arg[0][10] : 0;
  a02=(a02*a05);
  a00=(a00+a02);
  if (res[0]!=0) res[0][9]=a00;
  a00=3.7890204819224786e-03;
  a00=(a00*a06);
  a06=-1.2820884334724702e-02;
  a06=(a06*a05);
  a00=(a00+a06);
  a06=9.0318638528022240e-03;
  a02=arg[0]? arg[0][11] : 0;
  a06=(a06*a02);
  a00=(a00+a06);
  if (res[0]!=0) res[0][10]=a00;
  a00=9.0482037313966927e-03;
  a00=(a00*a05);
  a05=-2.6468867113033718e-02;
  a05=(a05*a02);
  a00=(a00+a05);
  a05=1.7420663381637023e-02;
  a06=arg[0]? arg[0][12] : 0;
  a05=(a05*a06);
  a00=(a00+a05);
  if (res[0]!=0) res[0][11]=a00;
  a00=2.0300906840222066e-02;
  a00=(a00*a02);
  a02=-5.5382723631968798e-02;
  a02=(a02*a06);
  a00=(a00+a02);
  a02=3.5081816791746732e-02;
  a05=arg[0]? arg[0][13] : 0;
  a02=(a02*a05);
  a00=(a00+a02);
  if (res[0]!=0) res[0][12]=a00;
  a00=4.4390741818751973e-02;
  a00=(a00*a06);
  a06=-1.1650292501900260e-01;
  a06=(a06*a05);
  a00=(a00+a06);
  a06=7.2112183200250618e-02;
  a02=arg[0]? arg[0][14] : 0;
  a06=(a06*a02);
  a00=(a00+a06);
  if (res[0]!=0) res[0][13]=a00;
  a00=9.5824854795310097e-02;
  a00=(a00*a05);
  a05=-2.4571197353722243e-01;
  a05=(a05*a02);
  a00=(a00+a05);
  a05=1.4988711874191235e-01;
  a06=arg[0]? arg[0][15] : 0;
  a05=(a05*a06);
  a00=(a00+a05);
  if (res[0]!=0) res[0][14]=a00;
  a00=2.0537060306061883e-01;
  a00=(a00*a02);
  a05=-2.0537060306061883e-01;
  a05=(a05*a06);
  a00=(a00+a05);
  a05=4.5555665174285741e-04;
  a05=(a05*a04);
  a00=(a00+a05);
  if (res[0]!=0) res[0][15]=a00;
  a00=1.1844825459383240e-03;
  a00=(a00*a04);
  a05=-4.6948356807511736e+01;
  a07=4.9083949893520106e-06;
  a07=(a07*a04);
  a08=-4.9083949893520106e-06;
  a08=(a08*a04);
  a07=(a07+a08);
  a07=(a05*a07);
  a08=4.6948356807511736e+01;
  a09=-1.8779342723004699e+08;
  a10=arg[0]? arg[0][16] : 0;
  a11=(a09*a10);
  a12=1.8779342723004699e+08;
  a13=arg[0]? arg[0][17] : 0;
  a14=(a12*a13);
  a11=(a11+a14);
  a14=5.0000000000000000e-01;
  a15=-6.0775000000000005e-11;
  a16=-1.0992499999999999e-17;
  a17=4000.;
  a18=(a17*a10);
  a19=10.;
  a20=casadi_fmax(a18,a19);
  a21=casadi_sq(a20);
  a21=(a16*a21);
  a22=-4.9650000000000002e-14;
  a20=(a22*a20);
  a21=(a21-a20);
  a21=(a15+a21);
  a21=(a14/a21);
  a20=(a17*a13);
  a23=casadi_fmax(a20,a19);
  a24=casadi_sq(a23);
  a24=(a16*a24);
  a23=(a22*a23);
  a24=(a24-a23);
  a24=(a15+a24);
  a23=(a14/a24);
  a21=(a21+a23);
  a11=(a11/a21);
  a21=1.6361316631173368e-06;
  a21=(a21*a04);
  a23=4.9083949893520098e-06;
  a23=(a23*a04);
  a21=(a21+a23);
  a11=(a11+a21);
  a21=(a08*a11);
  a07=(a07+a21);
  a07=(a00-a07);
  if (res[0]!=0) res[0][16]=a07;
  a05=(a05*a11);
  a09=(a09*a13);
  a11=arg[0]? arg[0][18] : 0;
  a12=(a12*a11);
  a09=(a09+a12);
  a12=5.0000000000000011e-01;
  a12=(a12/a24);
  a24=4.9999999999999989e-01;
  a07=(a17*a11);
  a21=casadi_fmax(a07,a19);
  a23=casadi_sq(a21);
  a23=(a16*a23);
  a21=(a22*a21);
  a23=(a23-a21);
  a23=(a15+a23);
  a24=(a24/a23);
  a12=(a12+a24);
  a09=(a09/a12);
  a12=4.9083949893520089e-06;
  a12=(a12*a04);
  a24=8.1806583155866829e-06;
  a24=(a24*a04);
  a12=(a12+a24);
  a09=(a09+a12);
  a08=(a08*a09);
  a05=(a05+a08);
  a05=(a00-a05);
  if (res[0]!=0) res[0][17]=a05;
  a05=-4.6948356807511743e+01;
  a05=(a05*a09);
  a09=4.6948356807511743e+01;
  a08=-1.8779342723004693e+08;
  a08=(a08*a11);
  a12=1.8779342723004693e+08;
  a24=arg[0]? arg[0][19] : 0;
  a12=(a12*a24);
  a08=(a08+a12);
  a12=4.9999999999999994e-01;
  a12=(a12/a23);
  a17=(a17*a24);
  a23=casadi_fmax(a17,a19);
  a21=casadi_sq(a23);
  a16=(a16*a21);
  a22=(a22*a23);
  a16=(a16-a22);
  a15=(a15+a16);
  a16=(a14/a15);
  a12=(a12+a16);
  a08=(a08/a12);
  a12=8.1806583155866812e-06;
  a12=(a12*a04);
  a16=1.1452921641821356e-05;
  a16=(a16*a04);
  a12=(a12+a16);
  a08=(a08+a12);
  a09=(a09*a08);
  a05=(a05+a09);
  a05=(a00-a05);
  if (res[0]!=0) res[0][18]=a05;
  a05=-4.6948356807511729e+01;
  a05=(a05*a08);
  a08=4.6948356807511729e+01;
  a09=-2.4024024024024028e+08;
  a09=(a09*a24);
  a12=1.2778736182991502e+08;
  a16=arg[0]? arg[0][20] : 0;
  a12=(a12*a16);
  a09=(a09+a12);
  a12=6.3963963963963955e-01;
  a12=(a12/a15);
  a15=3.6036036036036045e-01;
  a22=-1.5666130553560444e-10;
  a23=-2.8335654481285585e-17;
  a21=2.1276595744680849e+03;
  a21=(a21*a16);
  a25=casadi_fmax(a21,a19);
  a26=casadi_sq(a25);
  a23=(a23*a26);
  a26=-1.2798410234212686e-13;
  a26=(a26*a25);
  a23=(a23-a26);
  a22=(a22+a23);
  a15=(a15/a22);
  a12=(a12+a15);
  a09=(a09/a12);
  a12=8.2543579400514314e-06;
  a12=(a12*a04);
  a15=1.6744554678390039e-05;
  a15=(a15*a04);
  a12=(a12+a15);
  a09=(a09+a12);
  a08=(a08*a09);
  a05=(a05+a08);
  a00=(a00-a05);
  if (res[0]!=0) res[0][19]=a00;
  a00=-8.3333333333333286e+01;
  a00=(a00*a09);
  a09=8.3333333333333286e+01;
  a05=-1.3771259381670445e+08;
  a05=(a05*a16);
  a08=1.9320871371298832e+08;
  a12=arg[0]? arg[0][21] : 0;
  a08=(a08*a12);
  a05=(a05+a08);
  a08=3.8834951456310696e-01;
  a08=(a08/a22);
  a22=6.1165048543689304e-01;
  a15=-9.4271879360788195e-11;
  a23=-1.7051149878625489e-17;
  a26=2.9850746268656712e+03;
  a25=(a26*a12);
  a27=casadi_fmax(a25,a19);
  a28=casadi_sq(a27);
  a28=(a23*a28);
  a29=-7.7015200497953656e-14;
  a27=(a29*a27);
  a28=(a28-a27);
  a28=(a15+a28);
  a22=(a22/a28);
  a08=(a08+a22);
  a05=(a05/a08);
  a08=1.6011851615750243e-05;
  a08=(a08*a04);
  a22=8.8954731198612532e-06;
  a22=(a22*a04);
  a08=(a08+a22);
  a05=(a05+a08);
  a09=(a09*a05);
  a00=(a00+a09);
  a00=(-a00);
  if (res[0]!=0) res[0][20]=a00;
  a00=-1.3348930279622384e-03;
  a00=(a00*a04);
  a09=-5.2910052910052919e+01;
  a05=(a09*a05);
  a08=5.2910052910052919e+01;
  a22=-1.5794045644791925e+08;
  a22=(a22*a12);
  a27=1.5794045644791925e+08;
  a30=arg[0]? arg[0][22] : 0;
  a27=(a27*a30);
  a22=(a22+a27);
  a28=(a14/a28);
  a27=(a26*a30);
  a31=casadi_fmax(a27,a19);
  a32=casadi_sq(a31);
  a32=(a23*a32);
  a31=(a29*a31);
  a32=(a32-a31);
  a32=(a15+a32);
  a32=(a14/a32);
  a28=(a28+a32);
  a22=(a22/a28);
  a28=1.1452921641821358e-05;
  a28=(a28*a04);
  a31=8.1806583155866863e-06;
  a31=(a31*a04);
  a28=(a28+a31);
  a22=(a22+a28);
  a28=(a08*a22);
  a05=(a05+a28);
  a05=(a00-a05);
  if (res[0]!=0) res[0][21]=a05;
  a22=(a09*a22);
  a05=-1.5794045644791889e+08;
  a05=(a05*a30);
  a28=1.5794045644791889e+08;
  a33=arg[0]? arg[0][23] : 0;
  a28=(a28*a33);
  a05=(a05+a28);
  a28=(a26*a33);
  a34=casadi_fmax(a28,a19);
  a35=casadi_sq(a34);
  a35=(a23*a35);
  a34=(a29*a34);
  a35=(a35-a34);
  a35=(a15+a35);
  a35=(a14/a35);
  a32=(a32+a35);
  a05=(a05/a32);
  a32=4.9083949893520081e-06;
  a32=(a32*a04);
  a31=(a31+a32);
  a05=(a05+a31);
  a31=(a08*a05);
  a22=(a22+a31);
  a22=(a00-a22);
  if (res[0]!=0) res[0][22]=a22;
  a05=(a09*a05);
  a22=-1.5794045644791934e+08;
  a22=(a22*a33);
  a31=1.5794045644791934e+08;
  a34=arg[0]? arg[0][24] : 0;
  a31=(a31*a34);
  a22=(a22+a31);
  a26=(a26*a34);
  a31=casadi_fmax(a26,a19);
  a36=casadi_sq(a31);
  a23=(a23*a36);
  a29=(a29*a31);
  a23=(a23-a29);
  a15=(a15+a23);
  a15=(a14/a15);
  a35=(a35+a15);
  a22=(a22/a35);
  a35=1.6361316631173391e-06;
  a35=(a35*a04);
  a32=(a32+a35);
  a22=(a22+a32);
  a32=(a08*a22);
  a05=(a05+a32);
  a05=(a00-a05);
  if (res[0]!=0) res[0][23]=a05;
  a09=(a09*a22);
  a22=-4.9083949893520148e-06;
  a22=(a22*a04);
  a05=4.9083949893520199e-06;
  a05=(a05*a04);
  a22=(a22+a05);
  a08=(a08*a22);
  a09=(a09+a08);
  a00=(a00-a09);
  if (res[0]!=0) res[0][24]=a00;
  a00=3.3540164346805303e-03;
  a09=4.6765234445171537e-14;
  a08=casadi_sq(a04);
  a09=(a09*a08);
  a22=2.0455824700323214e-07;
  a05=1.1428519183912300e+05;
  a05=(a05*a04);
  a32=5.1385158242171686e-02;
  a35=arg[0]? arg[0][25] : 0;
  a32=(a32*a35);
  a15=2.5000000000000000e-01;
  a23=2.9764943296767143e-01;
  a23=(a23*a04);
  a29=0.;
  a31=6.4799999999999998e-07;
  a36=1.4118840940786221e+01;
  a37=(a36/a35);
  a36=(a36-a37);
  a36=exp(a36);
  a31=(a31*a36);
  a36=3.1622776601683793e+01;
  a37=casadi_fmax(a18,a29);
  a38=1000.;
  a37=(a37/a38);
  a39=1.0000000000000000e-03;
  a40=casadi_hypot(a39,a37);
  a40=sqrt(a40);
  a37=(a37/a40);
  a37=(a36*a37);
  a37=(a31*a37);
  a40=-1.3496177543721900e+04;
  a40=(a40*a01);
  a41=4.6629177543721897e+04;
  a41=(a41*a03);
  a40=(a40+a41);
  a41=33133.;
  a40=casadi_fmin(a40,a41);
  a40=casadi_fmax(a40,a29);
  a42=casadi_hypot(a39,a40);
  a42=sqrt(a42);
  a42=(a40/a42);
  a37=(a37*a42);
  a41=(a41-a40);
  a40=casadi_hypot(a39,a41);
  a40=sqrt(a40);
  a41=(a41/a40);
  a37=(a37*a41);
  a37=(2.*a37);
  a40=(a29<=a37);
  a40=(2.*a40);
  a43=1.;
  a40=(a40-a43);
  a44=9.9999999999999998e-17;
  a37=casadi_hypot(a44,a37);
  a40=(a40*a37);
  a40=(a23/a40);
  a40=asinh(a40);
  a40=(a15*a40);
  a37=casadi_fmax(a20,a29);
  a37=(a37/a38);
  a45=casadi_hypot(a39,a37);
  a45=sqrt(a45);
  a37=(a37/a45);
  a37=(a36*a37);
  a37=(a31*a37);
  a37=(a37*a42);
  a37=(a37*a41);
  a37=(2.*a37);
  a45=(a29<=a37);
  a45=(2.*a45);
  a45=(a45-a43);
  a37=casadi_hypot(a44,a37);
  a45=(a45*a37);
  a45=(a23/a45);
  a45=asinh(a45);
  a45=(a15*a45);
  a40=(a40+a45);
  a45=2.4999999999999994e-01;
  a37=casadi_fmax(a07,a29);
  a37=(a37/a38);
  a46=casadi_hypot(a39,a37);
  a46=sqrt(a46);
  a37=(a37/a46);
  a37=(a36*a37);
  a37=(a31*a37);
  a37=(a37*a42);
  a37=(a37*a41);
  a37=(2.*a37);
  a46=(a29<=a37);
  a46=(2.*a46);
  a46=(a46-a43);
  a37=casadi_hypot(a44,a37);
  a46=(a46*a37);
  a46=(a23/a46);
  a46=asinh(a46);
  a46=(a45*a46);
  a40=(a40+a46);
  a46=2.5000000000000006e-01;
  a37=casadi_fmax(a17,a29);
  a37=(a37/a38);
  a47=casadi_hypot(a39,a37);
  a47=sqrt(a47);
  a37=(a37/a47);
  a37=(a36*a37);
  a31=(a31*a37);
  a31=(a31*a42);
  a31=(a31*a41);
  a31=(2.*a31);
  a41=(a29<=a31);
  a41=(2.*a41);
  a41=(a41-a43);
  a31=casadi_hypot(a44,a31);
  a41=(a41*a31);
  a23=(a23/a41);
  a23=asinh(a23);
  a23=(a46*a23);
  a40=(a40+a23);
  a40=(a32*a40);
  a05=(a05*a40);
  a23=8.5199610516066198e+00;
  a23=(a23*a04);
  a41=-1.0614569416453428e-02;
  a41=(a41*a04);
  a31=-2.7597880482778919e-02;
  a31=(a31*a04);
  a41=(a41+a31);
  a41=(a23*a41);
  a41=(a15*a41);
  a31=6.0856864654332998e+00;
  a31=(a31*a04);
  a42=1.0614569416453432e-02;
  a42=(a42*a04);
  a37=-3.8920087860329237e-02;
  a37=(a37*a04);
  a42=(a42+a37);
  a42=(a31*a42);
  a42=(a15*a42);
  a41=(a41+a42);
  a42=3.6514118792599808e+00;
  a42=(a42*a04);
  a37=2.7597880482778919e-02;
  a37=(a37*a04);
  a47=-1.2063506749473347e-17;
  a47=(a47*a04);
  a37=(a37+a47);
  a47=-4.4581191549104393e-02;
  a47=(a47*a04);
  a37=(a37+a47);
  a42=(a42*a37);
  a42=(a45*a42);
  a41=(a41+a42);
  a42=1.2171372930866611e+00;
  a42=(a42*a04);
  a37=3.8920087860329231e-02;
  a37=(a37*a04);
  a37=(a37+a47);
  a42=(a42*a37);
  a42=(a46*a42);
  a41=(a41+a42);
  a42=1.2171372930866600e+00;
  a42=(a42*a04);
  a37=-2.3474178403755872e+04;
  a47=-1.2962512171372928e-06;
  a47=(a47*a04);
  a48=2.4820000000000000e-01;
  a49=1.9793000000000001e+00;
  a50=-3.9363100000000003e+01;
  a51=-4.0733340004593310e-01;
  a51=(a51*a01);
  a01=1.4073334000459330e+00;
  a01=(a01*a03);
  a51=(a51+a01);
  a01=9.9999999989999999e-01;
  a03=casadi_fmin(a51,a01);
  a52=1.0000000000000000e-10;
  a03=casadi_fmax(a03,a52);
  a50=(a50*a03);
  a50=exp(a50);
  a49=(a49*a50);
  a48=(a48+a49);
  a49=9.0899999999999995e-02;
  a50=-3.6839589199999998e+00;
  a53=2.9853800000000000e+01;
  a53=(a53*a03);
  a50=(a50+a53);
  a50=tanh(a50);
  a49=(a49*a50);
  a48=(a48-a49);
  a49=4.4780000000000000e-02;
  a50=-4.1302127099999995e+00;
  a53=1.4915900000000001e+01;
  a53=(a53*a03);
  a50=(a50+a53);
  a50=tanh(a50);
  a49=(a49*a50);
  a48=(a48-a49);
  a49=2.0500000000000001e-02;
  a50=-1.8580217319999999e+01;
  a53=3.0444400000000002e+01;
  a53=(a53*a03);
  a50=(a50+a53);
  a50=tanh(a50);
  a49=(a49*a50);
  a48=(a48-a49);
  a49=2.0505686219374840e+02;
  a50=-5.3208479782653813e+00;
  a53=-6.9101921795654307e+03;
  a03=-6.0863211116347574e-03;
  a54=casadi_fmax(a03,a51);
  a54=(a53*a54);
  a54=(a50+a54);
  a54=exp(a54);
  a54=(a43+a54);
  a54=log(a54);
  a54=(a49*a54);
  a55=-1.4169823254974664e+06;
  a56=6.0863211116347574e-03;
  a57=(a56+a51);
  a57=casadi_fmin(a29,a57);
  a57=(a55*a57);
  a54=(a54+a57);
  a57=(a43-a51);
  a57=casadi_fmax(a03,a57);
  a57=(a53*a57);
  a57=(a50+a57);
  a57=exp(a57);
  a57=(a43+a57);
  a57=log(a57);
  a57=(a49*a57);
  a58=1.0060863211116347e+00;
  a51=(a58-a51);
  a51=casadi_fmin(a29,a51);
  a51=(a55*a51);
  a57=(a57+a51);
  a54=(a54-a57);
  a48=(a48+a54);
  a40=(a40+a48);
  a47=(a47-a40);
  a40=3.8055848194152343e-02;
  a40=(a40*a35);
  a48=4.2229548977433558e+02;
  a10=(a48*a10);
  a48=(a48*a13);
  a10=(a10+a48);
  a48=4.2229548977433546e+02;
  a48=(a48*a11);
  a10=(a10+a48);
  a48=4.2229548977433564e+02;
  a48=(a48*a24);
  a10=(a10+a48);
  a48=2.3791295198554127e+02;
  a48=(a48*a16);
  a10=(a10+a48);
  a48=3.7471289937722736e+02;
  a12=(a48*a12);
  a10=(a10+a12);
  a30=(a48*a30);
  a10=(a10+a30);
  a33=(a48*a33);
  a10=(a10+a33);
  a48=(a48*a34);
  a10=(a10+a48);
  a18=(a18/a10);
  a48=1.0000000000000001e-15;
  a18=casadi_fmax(a18,a48);
  a18=log(a18);
  a34=(a15*a18);
  a20=(a20/a10);
  a20=casadi_fmax(a20,a48);
  a20=log(a20);
  a33=(a15*a20);
  a34=(a34+a33);
  a07=(a07/a10);
  a07=casadi_fmax(a07,a48);
  a07=log(a07);
  a33=(a45*a07);
  a34=(a34+a33);
  a17=(a17/a10);
  a17=casadi_fmax(a17,a48);
  a17=log(a17);
  a33=(a46*a17);
  a34=(a34+a33);
  a34=(a40*a34);
  a47=(a47-a34);
  a34=8.2960077896786742e-04;
  a34=(a34*a04);
  a33=3.3333333333333331e-01;
  a30=1.6212500000000003e-11;
  a19=casadi_fmax(a10,a19);
  a12=casadi_sq(a19);
  a12=(a19*a12);
  a30=(a30*a12);
  a16=9.9216461587782902e-06;
  a24=1.5000000000000000e+00;
  a24=pow(a19,a24);
  a16=(a16*a24);
  a30=(a30-a16);
  a16=4.1612500000000005e-04;
  a16=(a16*a19);
  a30=(a30+a16);
  a33=(a33/a30);
  a16=4.1791384878584733e-11;
  a16=(a16*a12);
  a11=2.5575286553624381e-05;
  a11=(a11*a24);
  a16=(a16-a11);
  a11=1.0726562857425487e-03;
  a11=(a11*a19);
  a16=(a16+a11);
  a11=(1./a16);
  a33=(a33-a11);
  a33=(a34*a33);
  a47=(a47-a33);
  a18=(a40*a18);
  a18=(a47+a18);
  a33=-4.1934374999999994e-05;
  a11=9.7370983446932797e+00;
  a11=(a11*a04);
  a30=(a11/a30);
  a33=(a33*a30);
  a18=(a18-a33);
  a34=(a34/a16);
  a18=(a18-a34);
  a18=(a37*a18);
  a33=2.3474178403755872e+04;
  a20=(a40*a20);
  a20=(a47+a20);
  a13=-3.6609375000000000e-05;
  a13=(a13*a30);
  a20=(a20-a13);
  a20=(a20-a34);
  a13=(a33*a20);
  a13=(a18+a13);
  a13=(a42*a13);
  a13=(a15*a13);
  a54=3.6514118792599799e+00;
  a54=(a54*a04);
  a07=(a40*a07);
  a07=(a47+a07);
  a57=-2.5959374999999999e-05;
  a57=(a57*a30);
  a07=(a07-a57);
  a07=(a07-a34);
  a33=(a33*a07);
  a18=(a18+a33);
  a54=(a54*a18);
  a54=(a15*a54);
  a13=(a13+a54);
  a54=6.0856864654332981e+00;
  a54=(a54*a04);
  a37=(a37*a20);
  a20=7.2759576141834259e-12;
  a20=(a20*a07);
  a37=(a37+a20);
  a20=2.3474178403755865e+04;
  a17=(a40*a17);
  a17=(a47+a17);
  a18=-9.9843749999999987e-06;
  a18=(a18*a30);
  a17=(a17-a18);
  a17=(a17-a34);
  a20=(a20*a17);
  a37=(a37+a20);
  a54=(a54*a37);
  a45=(a45*a54);
  a13=(a13+a45);
  a45=-2.3474178403755865e+04;
  a45=(a45*a07);
  a45=(a45+a20);
  a20=6.0060060060060066e+04;
  a21=(a21/a10);
  a21=casadi_fmax(a21,a48);
  a21=log(a21);
  a21=(a40*a21);
  a21=(a47+a21);
  a07=9.1199999999999994e-05;
  a54=(a11/a16);
  a07=(a07*a54);
  a21=(a21-a07);
  a07=(a20*a21);
  a20=(a20*a17);
  a07=(a07-a20);
  a07=(a14*a07);
  a45=(a45+a07);
  a45=(a23*a45);
  a46=(a46*a45);
  a13=(a13+a46);
  a41=(a41+a13);
  a05=(a05-a41);
  a22=(a22*a05);
  a05=2.8811020704680589e-08;
  a41=6.4724919093851095e+04;
  a13=(a25/a10);
  a13=casadi_fmax(a13,a48);
  a13=log(a13);
  a46=(a40*a13);
  a46=(a47+a46);
  a45=8.8593749999999833e-06;
  a20=2.5148216275389202e-11;
  a20=(a20*a12);
  a12=1.5390081937322494e-05;
  a12=(a12*a24);
  a20=(a20-a12);
  a12=6.4547734757726025e-04;
  a12=(a12*a19);
  a20=(a20+a12);
  a20=(a11/a20);
  a45=(a45*a20);
  a46=(a46-a45);
  a45=9.4644595910418688e-04;
  a45=(a45*a04);
  a45=(a45/a16);
  a46=(a46-a45);
  a16=(a41*a46);
  a41=(a41*a21);
  a16=(a16-a41);
  a14=(a14*a16);
  a07=(a07+a14);
  a11=(a11*a07);
  a05=(a05*a11);
  a22=(a22-a05);
  a05=1.8150943043948769e-07;
  a11=-1.2879759715202753e+05;
  a11=(a11*a04);
  a07=-3.3700423916470362e-01;
  a07=(a07*a04);
  a16=3.4199999999999999e-06;
  a41=7.1804391070284224e+00;
  a21=(a41/a35);
  a41=(a41-a21);
  a41=exp(a41);
  a16=(a16*a41);
  a25=casadi_fmax(a25,a29);
  a25=(a25/a38);
  a41=casadi_hypot(a39,a25);
  a41=sqrt(a41);
  a25=(a25/a41);
  a25=(a36*a25);
  a25=(a16*a25);
  a41=-2.5704366876497970e+04;
  a41=(a41*a02);
  a21=8.8808366876497967e+04;
  a21=(a21*a06);
  a41=(a41+a21);
  a21=63104.;
  a41=casadi_fmin(a41,a21);
  a41=casadi_fmax(a41,a29);
  a12=casadi_hypot(a39,a41);
  a12=sqrt(a12);
  a12=(a41/a12);
  a25=(a25*a12);
  a21=(a21-a41);
  a41=casadi_hypot(a39,a21);
  a41=sqrt(a41);
  a21=(a21/a41);
  a25=(a25*a21);
  a25=(2.*a25);
  a41=(a29<=a25);
  a41=(2.*a41);
  a41=(a41-a43);
  a25=casadi_hypot(a44,a25);
  a41=(a41*a25);
  a41=(a07/a41);
  a41=asinh(a41);
  a41=(a15*a41);
  a25=casadi_fmax(a27,a29);
  a25=(a25/a38);
  a19=casadi_hypot(a39,a25);
  a19=sqrt(a19);
  a25=(a25/a19);
  a25=(a36*a25);
  a25=(a16*a25);
  a25=(a25*a12);
  a25=(a25*a21);
  a25=(2.*a25);
  a19=(a29<=a25);
  a19=(2.*a19);
  a19=(a19-a43);
  a25=casadi_hypot(a44,a25);
  a19=(a19*a25);
  a19=(a07/a19);
  a19=asinh(a19);
  a19=(a15*a19);
  a41=(a41+a19);
  a19=casadi_fmax(a28,a29);
  a19=(a19/a38);
  a25=casadi_hypot(a39,a19);
  a25=sqrt(a25);
  a19=(a19/a25);
  a19=(a36*a19);
  a19=(a16*a19);
  a19=(a19*a12);
  a19=(a19*a21);
  a19=(2.*a19);
  a25=(a29<=a19);
  a25=(2.*a25);
  a25=(a25-a43);
  a19=casadi_hypot(a44,a19);
  a25=(a25*a19);
  a25=(a07/a25);
  a25=asinh(a25);
  a25=(a15*a25);
  a41=(a41+a25);
  a25=casadi_fmax(a26,a29);
  a25=(a25/a38);
  a39=casadi_hypot(a39,a25);
  a39=sqrt(a39);
  a25=(a25/a39);
  a36=(a36*a25);
  a16=(a16*a36);
  a16=(a16*a12);
  a16=(a16*a21);
  a16=(2.*a16);
  a21=(a29<=a16);
  a21=(2.*a21);
  a21=(a21-a43);
  a44=casadi_hypot(a44,a16);
  a21=(a21*a44);
  a07=(a07/a21);
  a07=asinh(a07);
  a07=(a15*a07);
  a41=(a41+a07);
  a32=(a32*a41);
  a11=(a11*a32);
  a41=-2.6455026455026476e+04;
  a07=4.4874999999999998e+00;
  a21=-8.0900000000000005e-01;
  a44=-4.0733340004592372e-01;
  a44=(a44*a02);
  a02=1.4073334000459237e+00;
  a02=(a02*a06);
  a44=(a44+a02);
  a01=casadi_fmin(a44,a01);
  a01=casadi_fmax(a01,a52);
  a21=(a21*a01);
  a07=(a07+a21);
  a21=4.2799999999999998e-02;
  a52=-1.0260347960000001e+01;
  a02=1.8513800000000000e+01;
  a02=(a02*a01);
  a52=(a52+a02);
  a52=tanh(a52);
  a21=(a21*a52);
  a07=(a07-a21);
  a21=1.7732600000000001e+01;
  a52=-4.9214312999999992e+00;
  a02=1.5789000000000000e+01;
  a02=(a02*a01);
  a52=(a52+a02);
  a52=tanh(a52);
  a21=(a21*a52);
  a07=(a07-a21);
  a21=1.7584199999999999e+01;
  a52=-4.9704096000000000e+00;
  a02=1.5930800000000000e+01;
  a02=(a02*a01);
  a52=(a52+a02);
  a52=tanh(a52);
  a21=(a21*a52);
  a07=(a07+a21);
  a21=casadi_fmax(a03,a44);
  a21=(a53*a21);
  a21=(a50+a21);
  a21=exp(a21);
  a21=(a43+a21);
  a21=log(a21);
  a21=(a49*a21);
  a56=(a56+a44);
  a56=casadi_fmin(a29,a56);
  a56=(a55*a56);
  a21=(a21+a56);
  a56=(a43-a44);
  a03=casadi_fmax(a03,a56);
  a53=(a53*a03);
  a50=(a50+a53);
  a50=exp(a50);
  a43=(a43+a50);
  a43=log(a43);
  a49=(a49*a43);
  a58=(a58-a44);
  a29=casadi_fmin(a29,a58);
  a55=(a55*a29);
  a49=(a49+a55);
  a21=(a21-a49);
  a07=(a07+a21);
  a32=(a32+a07);
  a13=(a15*a13);
  a27=(a27/a10);
  a27=casadi_fmax(a27,a48);
  a27=log(a27);
  a07=(a15*a27);
  a13=(a13+a07);
  a28=(a28/a10);
  a28=casadi_fmax(a28,a48);
  a28=log(a28);
  a07=(a15*a28);
  a13=(a13+a07);
  a26=(a26/a10);
  a26=casadi_fmax(a26,a48);
  a26=log(a26);
  a48=(a15*a26);
  a13=(a13+a48);
  a13=(a40*a13);
  a13=(a47+a13);
  a48=2.5396874999999985e-05;
  a48=(a48*a20);
  a13=(a13-a48);
  a13=(a13-a45);
  a32=(a32+a13);
  a13=7.9844206426484890e-03;
  a13=(a13*a04);
  a32=(a32+a13);
  a13=7.3347736124634837e-03;
  a13=(a13*a04);
  a13=(a32-a13);
  a13=(a41*a13);
  a48=2.6455026455026476e+04;
  a10=7.5903724440116822e-03;
  a10=(a10*a04);
  a10=(a32-a10);
  a07=(a48*a10);
  a07=(a13+a07);
  a42=(a42*a07);
  a42=(a15*a42);
  a07=3.6514118792599777e+00;
  a07=(a07*a04);
  a21=5.8207660913467407e-11;
  a49=(a21*a10);
  a13=(a13+a49);
  a49=2.6455026455026418e+04;
  a55=8.1015701071080800e-03;
  a55=(a55*a04);
  a55=(a32-a55);
  a29=(a49*a55);
  a13=(a13+a29);
  a07=(a07*a13);
  a07=(a15*a07);
  a42=(a42+a07);
  a07=-2.6455026455026418e+04;
  a10=(a07*a10);
  a13=-7.6397554948925972e-11;
  a29=(a13*a55);
  a10=(a10+a29);
  a29=2.6455026455026495e+04;
  a58=8.8683666017526745e-03;
  a58=(a58*a04);
  a32=(a32-a58);
  a32=(a29*a32);
  a10=(a10+a32);
  a31=(a31*a10);
  a31=(a15*a31);
  a42=(a42+a31);
  a31=8.5199610516066162e+00;
  a31=(a31*a04);
  a10=-2.6455026455026495e+04;
  a55=(a10*a55);
  a55=(a55+a32);
  a32=-2.7047495401925776e+01;
  a32=(a32*a04);
  a55=(a55+a32);
  a31=(a31*a55);
  a31=(a15*a31);
  a42=(a42+a31);
  a41=(a41*a46);
  a27=(a40*a27);
  a27=(a47+a27);
  a46=2.3034374999999972e-05;
  a46=(a46*a20);
  a27=(a27-a46);
  a27=(a27-a45);
  a48=(a48*a27);
  a48=(a41+a48);
  a48=(a48+a14);
  a23=(a23*a48);
  a23=(a15*a23);
  a48=6.0856864654333016e+00;
  a48=(a48*a04);
  a21=(a21*a27);
  a41=(a41+a21);
  a28=(a40*a28);
  a28=(a47+a28);
  a21=3.2484375000000002e-05;
  a21=(a21*a20);
  a28=(a28-a21);
  a28=(a28-a45);
  a49=(a49*a28);
  a41=(a41+a49);
  a48=(a48*a41);
  a48=(a15*a48);
  a23=(a23+a48);
  a48=3.6514118792599781e+00;
  a48=(a48*a04);
  a07=(a07*a27);
  a13=(a13*a28);
  a07=(a07+a13);
  a40=(a40*a26);
  a47=(a47+a40);
  a40=3.7209374999999988e-05;
  a40=(a40*a20);
  a47=(a47-a40);
  a47=(a47-a45);
  a29=(a29*a47);
  a07=(a07+a29);
  a48=(a48*a07);
  a48=(a15*a48);
  a23=(a23+a48);
  a48=1.2171372930866617e+00;
  a48=(a48*a04);
  a10=(a10*a28);
  a10=(a10+a29);
  a48=(a48*a10);
  a15=(a15*a48);
  a23=(a23+a15);
  a42=(a42+a23);
  a11=(a11-a42);
  a05=(a05*a11);
  a22=(a22+a05);
  a09=(a09+a22);
  a22=9.8665514770436280e-14;
  a22=(a22*a08);
  a09=(a09+a22);
  a22=-3.7011466180350316e-01;
  a22=(a22*a35);
  a35=-1.2413706584051760e-03;
  a08=arg[1]? arg[1][1] : 0;
  a35=(a35*a08);
  a22=(a22-a35);
  a09=(a09+a22);
  a00=(a00*a09);
  if (res[0]!=0) res[0][25]=a00;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_rhs(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f1(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int cell_rhs_checkout(void) {
  return 0;
}

CASADI_SYMBOL_EXPORT void cell_rhs_release(int mem) {
}

CASADI_SYMBOL_EXPORT void cell_rhs_incref(void) {
}

CASADI_SYMBOL_EXPORT void cell_rhs_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int cell_rhs_n_in(void) { return 2;}

CASADI_SYMBOL_EXPORT casadi_int cell_rhs_n_out(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_real cell_rhs_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_rhs_name_in(casadi_int i) {
  switch (i) {
    case 0: return "i0";
    case 1: return "i1";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_rhs_name_out(casadi_int i) {
  switch (i) {
    case 0: return "o0";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_rhs_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s1;
    case 1: return casadi_s0;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_rhs_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s1;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT int cell_rhs_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_rhs_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}

/* cell_outputs:(i0[26],i1[3])->(o0[8]) */
static int casadi_f2(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a00, a01, a02, a03, a04, a05, a06, a07, a08, a09, a10, a11;
  casadi_real a12, a13, a14, a15, a16, a17, a18, a19, a20, a21, a22, a23;
  casadi_real a24, a25, a26, a27, a28, a29, a30, a31, a32, a33, a34, a35;
  casadi_real a36, a37, a38, a39, a40, a41, a42, a43, a44, a45, a46, a47;
  casadi_real a48, a49, a50, a51;
  a00=-5.0000000000000144e-01;
  a01=5.1385158242171686e-02;
  a02=arg[0]? arg[0][25] : 0;
  a01=(a01*a02);
  a03=2.5000000000000000e-01;
  a04=-3.3700423916470362e-01;
  a05=arg[1]? arg[1][0] : 0;
  a04=(a04*a05);
  a06=0.;
  a07=3.4199999999999999e-06;
  a08=7.1804391070284224e+00;
  a09=(a08/a02);
  a08=(a08-a09);
  a08=exp(a08);
  a07=(a07*a08);
  a08=3.1622776601683793e+01;
  a09=2.9850746268656712e+03;
  a10=arg[0]? arg[0][21] : 0;
  a11=(a09*a10);
  a12=casadi_fmax(a11,a06);
  a13=1000.;
  a12=(a12/a13);
  a14=1.0000000000000000e-03;
  a15=casadi_hypot(a14,a12);
  a15=sqrt(a15);
  a12=(a12/a15);
  a12=(a08*a12);
  a12=(a07*a12);
  a15=-2.5704366876497970e+04;
  a16=arg[0]? arg[0][14] : 0;
  a15=(a15*a16);
  a17=8.8808366876497967e+04;
  a18=arg[0]? arg[0][15] : 0;
  a17=(a17*a18);
  a15=(a15+a17);
  a17=63104.;
  a15=casadi_fmin(a15,a17);
  a15=casadi_fmax(a15,a06);
  a19=casadi_hypot(a14,a15);
  a19=sqrt(a19);
  a19=(a15/a19);
  a12=(a12*a19);
  a17=(a17-a15);
  a15=casadi_hypot(a14,a17);
  a15=sqrt(a15);
  a17=(a17/a15);
  a12=(a12*a17);
  a12=(2.*a12);
  a15=(a06<=a12);
  a15=(2.*a15);
  a20=1.;
  a15=(a15-a20);
  a21=9.9999999999999998e-17;
  a12=casadi_hypot(a21,a12);
  a15=(a15*a12);
  a15=(a04/a15);
  a15=asinh(a15);
  a15=(a03*a15);
  a12=arg[0]? arg[0][22] : 0;
  a22=(a09*a12);
  a23=casadi_fmax(a22,a06);
  a23=(a23/a13);
  a24=casadi_hypot(a14,a23);
  a24=sqrt(a24);
  a23=(a23/a24);
  a23=(a08*a23);
  a23=(a07*a23);
  a23=(a23*a19);
  a23=(a23*a17);
  a23=(2.*a23);
  a24=(a06<=a23);
  a24=(2.*a24);
  a24=(a24-a20);
  a23=casadi_hypot(a21,a23);
  a24=(a24*a23);
  a24=(a04/a24);
  a24=asinh(a24);
  a24=(a03*a24);
  a15=(a15+a24);
  a24=arg[0]? arg[0][23] : 0;
  a23=(a09*a24);
  a25=casadi_fmax(a23,a06);
  a25=(a25/a13);
  a26=casadi_hypot(a14,a25);
  a26=sqrt(a26);
  a25=(a25/a26);
  a25=(a08*a25);
  a25=(a07*a25);
  a25=(a25*a19);
  a25=(a25*a17);
  a25=(2.*a25);
  a26=(a06<=a25);
  a26=(2.*a26);
  a26=(a26-a20);
  a25=casadi_hypot(a21,a25);
  a26=(a26*a25);
  a26=(a04/a26);
  a26=asinh(a26);
  a26=(a03*a26);
  a15=(a15+a26);
  a26=arg[0]? arg[0][24] : 0;
  a09=(a09*a26);
  a25=casadi_fmax(a09,a06);
  a25=(a25/a13);
  a27=casadi_hypot(a14,a25);
  a27=sqrt(a27);
  a25=(a25/a27);
  a25=(a08*a25);
  a07=(a07*a25);
  a07=(a07*a19);
  a07=(a07*a17);
  a07=(2.*a07);
  a17=(a06<=a07);
  a17=(2.*a17);
  a17=(a17-a20);
  a07=casadi_hypot(a21,a07);
  a17=(a17*a07);
  a04=(a04/a17);
  a04=asinh(a04);
  a04=(a03*a04);
  a15=(a15+a04);
  a15=(a01*a15);
  a04=4.4874999999999998e+00;
  a17=-8.0900000000000005e-01;
  a07=-4.0733340004592372e-01;
  a07=(a07*a16);
  a19=1.4073334000459237e+00;
  a19=(a19*a18);
  a07=(a07+a19);
  a19=9.9999999989999999e-01;
  a25=casadi_fmin(a07,a19);
  a27=1.0000000000000000e-10;
  a25=casadi_fmax(a25,a27);
  a17=(a17*a25);
  a04=(a04+a17);
  a17=4.2799999999999998e-02;
  a28=-1.0260347960000001e+01;
  a29=1.8513800000000000e+01;
  a29=(a29*a25);
  a28=(a28+a29);
  a28=tanh(a28);
  a17=(a17*a28);
  a04=(a04-a17);
  a17=1.7732600000000001e+01;
  a28=-4.9214312999999992e+00;
  a29=1.5789000000000000e+01;
  a29=(a29*a25);
  a28=(a28+a29);
  a28=tanh(a28);
  a17=(a17*a28);
  a04=(a04-a17);
  a17=1.7584199999999999e+01;
  a28=-4.9704096000000000e+00;
  a29=1.5930800000000000e+01;
  a29=(a29*a25);
  a28=(a28+a29);
  a28=tanh(a28);
  a17=(a17*a28);
  a04=(a04+a17);
  a17=2.0505686219374840e+02;
  a28=-5.3208479782653813e+00;
  a29=-6.9101921795654307e+03;
  a25=-6.0863211116347574e-03;
  a30=casadi_fmax(a25,a07);
  a30=(a29*a30);
  a30=(a28+a30);
  a30=exp(a30);
  a30=(a20+a30);
  a30=log(a30);
  a30=(a17*a30);
  a31=-1.4169823254974664e+06;
  a32=6.0863211116347574e-03;
  a33=(a32+a07);
  a33=casadi_fmin(a06,a33);
  a33=(a31*a33);
  a30=(a30+a33);
  a33=(a20-a07);
  a34=casadi_fmax(a25,a33);
  a34=(a29*a34);
  a34=(a28+a34);
  a34=exp(a34);
  a34=(a20+a34);
  a34=log(a34);
  a34=(a17*a34);
  a35=1.0060863211116347e+00;
  a36=(a35-a07);
  a36=casadi_fmin(a06,a36);
  a36=(a31*a36);
  a34=(a34+a36);
  a30=(a30-a34);
  a04=(a04+a30);
  a15=(a15+a04);
  a04=-1.2962512171372928e-06;
  a04=(a04*a05);
  a30=2.9764943296767143e-01;
  a30=(a30*a05);
  a34=6.4799999999999998e-07;
  a36=1.4118840940786221e+01;
  a37=(a36/a02);
  a36=(a36-a37);
  a36=exp(a36);
  a34=(a34*a36);
  a36=4000.;
  a37=arg[0]? arg[0][16] : 0;
  a38=(a36*a37);
  a39=casadi_fmax(a38,a06);
  a39=(a39/a13);
  a40=casadi_hypot(a14,a39);
  a40=sqrt(a40);
  a39=(a39/a40);
  a39=(a08*a39);
  a39=(a34*a39);
  a40=-1.3496177543721900e+04;
  a41=arg[0]? arg[0][6] : 0;
  a40=(a40*a41);
  a42=4.6629177543721897e+04;
  a43=arg[0]? arg[0][7] : 0;
  a42=(a42*a43);
  a40=(a40+a42);
  a42=33133.;
  a40=casadi_fmin(a40,a42);
  a40=casadi_fmax(a40,a06);
  a44=casadi_hypot(a14,a40);
  a44=sqrt(a44);
  a44=(a40/a44);
  a39=(a39*a44);
  a42=(a42-a40);
  a40=casadi_hypot(a14,a42);
  a40=sqrt(a40);
  a42=(a42/a40);
  a39=(a39*a42);
  a39=(2.*a39);
  a40=(a06<=a39);
  a40=(2.*a40);
  a40=(a40-a20);
  a39=casadi_hypot(a21,a39);
  a40=(a40*a39);
  a40=(a30/a40);
  a40=asinh(a40);
  a40=(a03*a40);
  a39=arg[0]? arg[0][17] : 0;
  a45=(a36*a39);
  a46=casadi_fmax(a45,a06);
  a46=(a46/a13);
  a47=casadi_hypot(a14,a46);
  a47=sqrt(a47);
  a46=(a46/a47);
  a46=(a08*a46);
  a46=(a34*a46);
  a46=(a46*a44);
  a46=(a46*a42);
  a46=(2.*a46);
  a47=(a06<=a46);
  a47=(2.*a47);
  a47=(a47-a20);
  a46=casadi_hypot(a21,a46);
  a47=(a47*a46);
  a47=(a30/a47);
  a47=asinh(a47);
  a47=(a03*a47);
  a40=(a40+a47);
  a47=2.4999999999999994e-01;
  a46=arg[0]? arg[0][18] : 0;
  a48=(a36*a46);
  a49=casadi_fmax(a48,a06);
  a49=(a49/a13);
  a50=casadi_hypot(a14,a49);
  a50=sqrt(a50);
  a49=(a49/a50);
  a49=(a08*a49);
  a49=(a34*a49);
  a49=(a49*a44);
  a49=(a49*a42);
  a49=(2.*a49);
  a50=(a06<=a49);
  a50=(2.*a50);
  a50=(a50-a20);
  a49=casadi_hypot(a21,a49);
  a50=(a50*a49);
  a50=(a30/a50);
  a50=asinh(a50);
  a50=(a47*a50);
  a40=(a40+a50);
  a50=2.5000000000000006e-01;
  a49=arg[0]? arg[0][19] : 0;
  a36=(a36*a49);
  a51=casadi_fmax(a36,a06);
  a51=(a51/a13);
  a14=casadi_hypot(a14,a51);
  a14=sqrt(a14);
  a51=(a51/a14);
  a08=(a08*a51);
  a34=(a34*a08);
  a34=(a34*a44);
  a34=(a34*a42);
  a34=(2.*a34);
  a42=(a06<=a34);
  a42=(2.*a42);
  a42=(a42-a20);
  a21=casadi_hypot(a21,a34);
  a42=(a42*a21);
  a30=(a30/a42);
  a30=asinh(a30);
  a30=(a50*a30);
  a40=(a40+a30);
  a01=(a01*a40);
  a40=2.4820000000000000e-01;
  a30=1.9793000000000001e+00;
  a42=-3.9363100000000003e+01;
  a21=-4.0733340004593310e-01;
  a21=(a21*a41);
  a34=1.4073334000459330e+00;
  a34=(a34*a43);
  a21=(a21+a34);
  a19=casadi_fmin(a21,a19);
  a19=casadi_fmax(a19,a27);
  a42=(a42*a19);
  a42=exp(a42);
  a30=(a30*a42);
  a40=(a40+a30);
  a30=9.0899999999999995e-02;
  a42=-3.6839589199999998e+00;
  a27=2.9853800000000000e+01;
  a27=(a27*a19);
  a42=(a42+a27);
  a42=tanh(a42);
  a30=(a30*a42);
  a40=(a40-a30);
  a30=4.4780000000000000e-02;
  a42=-4.1302127099999995e+00;
  a27=1.4915900000000001e+01;
  a27=(a27*a19);
  a42=(a42+a27);
  a42=tanh(a42);
  a30=(a30*a42);
  a40=(a40-a30);
  a30=2.0500000000000001e-02;
  a42=-1.8580217319999999e+01;
  a27=3.0444400000000002e+01;
  a27=(a27*a19);
  a42=(a42+a27);
  a42=tanh(a42);
  a30=(a30*a42);
  a40=(a40-a30);
  a30=casadi_fmax(a25,a21);
  a30=(a29*a30);
  a30=(a28+a30);
  a30=exp(a30);
  a30=(a20+a30);
  a30=log(a30);
  a30=(a17*a30);
  a32=(a32+a21);
  a32=casadi_fmin(a06,a32);
  a32=(a31*a32);
  a30=(a30+a32);
  a32=(a20-a21);
  a25=casadi_fmax(a25,a32);
  a29=(a29*a25);
  a28=(a28+a29);
  a28=exp(a28);
  a20=(a20+a28);
  a20=log(a20);
  a17=(a17*a20);
  a35=(a35-a21);
  a06=casadi_fmin(a06,a35);
  a31=(a31*a06);
  a17=(a17+a31);
  a30=(a30-a17);
  a40=(a40+a30);
  a01=(a01+a40);
  a04=(a04-a01);
  a01=3.8055848194152343e-02;
  a01=(a01*a02);
  a40=4.2229548977433558e+02;
  a30=(a40*a37);
  a40=(a40*a39);
  a30=(a30+a40);
  a40=4.2229548977433546e+02;
  a40=(a40*a46);
  a30=(a30+a40);
  a40=4.2229548977433564e+02;
  a40=(a40*a49);
  a30=(a30+a40);
  a40=2.3791295198554127e+02;
  a17=arg[0]? arg[0][20] : 0;
  a40=(a40*a17);
  a30=(a30+a40);
  a40=3.7471289937722736e+02;
  a31=(a40*a10);
  a30=(a30+a31);
  a31=(a40*a12);
  a30=(a30+a31);
  a31=(a40*a24);
  a30=(a30+a31);
  a40=(a40*a26);
  a30=(a30+a40);
  a38=(a38/a30);
  a40=1.0000000000000001e-15;
  a38=casadi_fmax(a38,a40);
  a38=log(a38);
  a38=(a03*a38);
  a45=(a45/a30);
  a45=casadi_fmax(a45,a40);
  a45=log(a45);
  a45=(a03*a45);
  a38=(a38+a45);
  a48=(a48/a30);
  a48=casadi_fmax(a48,a40);
  a48=log(a48);
  a47=(a47*a48);
  a38=(a38+a47);
  a36=(a36/a30);
  a36=casadi_fmax(a36,a40);
  a36=log(a36);
  a50=(a50*a36);
  a38=(a38+a50);
  a38=(a01*a38);
  a04=(a04-a38);
  a38=8.2960077896786742e-04;
  a38=(a38*a05);
  a50=3.3333333333333331e-01;
  a36=1.6212500000000003e-11;
  a47=10.;
  a47=casadi_fmax(a30,a47);
  a48=casadi_sq(a47);
  a48=(a47*a48);
  a36=(a36*a48);
  a45=9.9216461587782902e-06;
  a31=1.5000000000000000e+00;
  a31=pow(a47,a31);
  a45=(a45*a31);
  a36=(a36-a45);
  a45=4.1612500000000005e-04;
  a45=(a45*a47);
  a36=(a36+a45);
  a50=(a50/a36);
  a36=4.1791384878584733e-11;
  a36=(a36*a48);
  a45=2.5575286553624381e-05;
  a45=(a45*a31);
  a36=(a36-a45);
  a45=1.0726562857425487e-03;
  a45=(a45*a47);
  a36=(a36+a45);
  a45=(1./a36);
  a50=(a50-a45);
  a38=(a38*a50);
  a04=(a04-a38);
  a11=(a11/a30);
  a11=casadi_fmax(a11,a40);
  a11=log(a11);
  a11=(a03*a11);
  a22=(a22/a30);
  a22=casadi_fmax(a22,a40);
  a22=log(a22);
  a22=(a03*a22);
  a11=(a11+a22);
  a23=(a23/a30);
  a23=casadi_fmax(a23,a40);
  a23=log(a23);
  a23=(a03*a23);
  a11=(a11+a23);
  a09=(a09/a30);
  a09=casadi_fmax(a09,a40);
  a09=log(a09);
  a03=(a03*a09);
  a11=(a11+a03);
  a01=(a01*a11);
  a04=(a04+a01);
  a01=2.5396874999999985e-05;
  a11=9.7370983446932797e+00;
  a11=(a11*a05);
  a03=2.5148216275389202e-11;
  a03=(a03*a48);
  a48=1.5390081937322494e-05;
  a48=(a48*a31);
  a03=(a03-a48);
  a48=6.4547734757726025e-04;
  a48=(a48*a47);
  a03=(a03+a48);
  a11=(a11/a03);
  a01=(a01*a11);
  a04=(a04-a01);
  a01=9.4644595910418688e-04;
  a01=(a01*a05);
  a01=(a01/a36);
  a04=(a04-a01);
  a15=(a15+a04);
  a04=7.9844206426484890e-03;
  a04=(a04*a05);
  a15=(a15+a04);
  a04=8.1015701071080800e-03;
  a04=(a04*a05);
  a04=(a15-a04);
  a00=(a00*a04);
  a04=1.5000000000000013e+00;
  a01=8.8683666017526745e-03;
  a01=(a01*a05);
  a15=(a15-a01);
  a04=(a04*a15);
  a00=(a00+a04);
  if (res[0]!=0) res[0][0]=a00;
  a00=-2.7314999999999998e+02;
  a04=2.9814999999999998e+02;
  a04=(a04*a02);
  a00=(a00+a04);
  if (res[0]!=0) res[0][1]=a00;
  a00=3.5642282161678231e-02;
  a04=arg[0]? arg[0][0] : 0;
  a00=(a00*a04);
  a15=1.3556969591976731e-01;
  a01=arg[0]? arg[0][1] : 0;
  a15=(a15*a01);
  a00=(a00+a15);
  a15=1.8780843560577762e-01;
  a05=arg[0]? arg[0][2] : 0;
  a15=(a15*a05);
  a00=(a00+a15);
  a15=1.8746927800854490e-01;
  a36=arg[0]? arg[0][3] : 0;
  a15=(a15*a36);
  a00=(a00+a15);
  a15=1.6087159121950168e-01;
  a11=arg[0]? arg[0][4] : 0;
  a15=(a15*a11);
  a00=(a00+a15);
  a15=1.2713614278406257e-01;
  a03=arg[0]? arg[0][5] : 0;
  a15=(a15*a03);
  a00=(a00+a15);
  a15=9.5675227887392231e-02;
  a15=(a15*a41);
  a00=(a00+a15);
  a15=6.9827346413275607e-02;
  a15=(a15*a43);
  a00=(a00+a15);
  a15=2.6345790270645771e-02;
  a00=(a00-a15);
  a15=8.8427225638176365e-01;
  a00=(a00/a15);
  if (res[0]!=0) res[0][2]=a00;
  if (res[0]!=0) res[0][3]=a21;
  if (res[0]!=0) res[0][4]=a07;
  if (res[0]!=0) res[0][5]=a32;
  if (res[0]!=0) res[0][6]=a33;
  a04=casadi_fmin(a04,a01);
  a04=casadi_fmin(a04,a05);
  a04=casadi_fmin(a04,a36);
  a04=casadi_fmin(a04,a11);
  a04=casadi_fmin(a04,a03);
  a04=casadi_fmin(a04,a41);
  a04=casadi_fmin(a04,a43);
  a43=arg[0]? arg[0][8] : 0;
  a04=casadi_fmin(a04,a43);
  a43=arg[0]? arg[0][9] : 0;
  a04=casadi_fmin(a04,a43);
  a43=arg[0]? arg[0][10] : 0;
  a04=casadi_fmin(a04,a43);
  a43=arg[0]? arg[0][11] : 0;
  a04=casadi_fmin(a04,a43);
  a43=arg[0]? arg[0][12] : 0;
  a04=casadi_fmin(a04,a43);
  a43=arg[0]? arg[0][13] : 0;
  a04=casadi_fmin(a04,a43);
  a04=casadi_fmin(a04,a16);
  a04=casadi_fmin(a04,a18);
  a04=casadi_fmin(a04,a37);
  a04=casadi_fmin(a04,a39);
  a04=casadi_fmin(a04,a46);
  a04=casadi_fmin(a04,a49);
  a04=casadi_fmin(a04,a17);
  a04=casadi_fmin(a04,a10);
  a04=casadi_fmin(a04,a12);
  a04=casadi_fmin(a04,a24);
  a04=casadi_fmin(a04,a26);
  a04=casadi_fmin(a04,a02);
  if (res[0]!=0) res[0][7]=a04;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_outputs(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f2(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int cell_outputs_checkout(void) {
  return 0;
}

CASADI_SYMBOL_EXPORT void cell_outputs_release(int mem) {
}

CASADI_SYMBOL_EXPORT void cell_outputs_incref(void) {
}

CASADI_SYMBOL_EXPORT void cell_outputs_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int cell_outputs_n_in(void) { return 2;}

CASADI_SYMBOL_EXPORT casadi_int cell_outputs_n_out(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_real cell_outputs_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_outputs_name_in(casadi_int i) {
  switch (i) {
    case 0: return "i0";
    case 1: return "i1";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_outputs_name_out(casadi_int i) {
  switch (i) {
    case 0: return "o0";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_outputs_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s1;
    case 1: return casadi_s0;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_outputs_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s2;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT int cell_outputs_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_outputs_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}

/* cell_radius:(i0[26],i1[3])->(o0) */
static int casadi_f3(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a00, a01, a02, a03, a04, a05, a06, a07, a08, a09, a10, a11;
  casadi_real a12, a13, a14, a15, a16, a17, a18, a19, a20, a21, a22, a23;
  casadi_real a24;
  a00=3.2170368701316510e+00;
  a01=4.6948356807511736e+01;
  a02=-1.8779342723004699e+08;
  a03=5.0000000000000000e-01;
  a04=-6.0775000000000005e-11;
  a05=-1.0992499999999999e-17;
  a06=4000.;
  a07=arg[0]? arg[0][16] : 0;
  a08=(a06*a07);
  a09=10.;
  a10=casadi_fmax(a08,a09);
  a11=casadi_sq(a10);
  a11=(a05*a11);
  a12=-4.9650000000000002e-14;
  a13=(a12*a10);
  a11=(a11-a13);
  a11=(a04+a11);
  a13=(a03/a11);
  a14=arg[0]? arg[0][17] : 0;
  a15=(a06*a14);
  a16=casadi_fmax(a15,a09);
  a17=casadi_sq(a16);
  a17=(a05*a17);
  a18=(a12*a16);
  a17=(a17-a18);
  a17=(a04+a17);
  a18=(a03/a17);
  a19=(a13+a18);
  a20=(a02/a19);
  a07=(a02*a07);
  a21=1.8779342723004699e+08;
  a22=(a21*a14);
  a07=(a07+a22);
  a07=(a07/a19);
  a07=(a07/a19);
  a13=(a13/a11);
  a10=(2.*a10);
  a11=(a09<=a08);
  a08=(a08<=a09);
  a08=(a11+a08);
  a11=(a11/a08);
  a08=(a06*a11);
  a10=(a10*a08);
  a10=(a05*a10);
  a08=-1.9860000000000002e-10;
  a11=(a08*a11);
  a10=(a10-a11);
  a13=(a13*a10);
  a13=(a07*a13);
  a20=(a20+a13);
  a13=(a01*a20);
  a13=casadi_fabs(a13);
  a19=(a21/a19);
  a18=(a18/a17);
  a16=(2.*a16);
  a10=(a09<=a15);
  a15=(a15<=a09);
  a15=(a10+a15);
  a10=(a10/a15);
  a15=(a06*a10);
  a16=(a16*a15);
  a16=(a05*a16);
  a10=(a08*a10);
  a16=(a16-a10);
  a18=(a18*a16);
  a07=(a07*a18);
  a19=(a19+a07);
  a07=(a01*a19);
  a07=casadi_fabs(a07);
  a13=(a13+a07);
  a00=casadi_fmax(a00,a13);
  a13=-4.6948356807511736e+01;
  a20=(a13*a20);
  a20=casadi_fabs(a20);
  a13=(a13*a19);
  a19=5.0000000000000011e-01;
  a19=(a19/a17);
  a07=4.9999999999999989e-01;
  a18=arg[0]? arg[0][18] : 0;
  a10=(a06*a18);
  a15=casadi_fmax(a10,a09);
  a11=casadi_sq(a15);
  a11=(a05*a11);
  a22=(a12*a15);
  a11=(a11-a22);
  a11=(a04+a11);
  a07=(a07/a11);
  a22=(a19+a07);
  a23=(a02/a22);
  a02=(a02*a14);
  a14=(a21*a18);
  a02=(a02+a14);
  a02=(a02/a22);
  a02=(a02/a22);
  a19=(a19/a17);
  a19=(a19*a16);
  a19=(a02*a19);
  a23=(a23+a19);
  a19=(a01*a23);
  a13=(a13+a19);
  a13=casadi_fabs(a13);
  a20=(a20+a13);
  a21=(a21/a22);
  a07=(a07/a11);
  a15=(2.*a15);
  a22=(a09<=a10);
  a10=(a10<=a09);
  a10=(a22+a10);
  a22=(a22/a10);
  a10=(a06*a22);
  a15=(a15*a10);
  a15=(a05*a15);
  a22=(a08*a22);
  a15=(a15-a22);
  a07=(a07*a15);
  a02=(a02*a07);
  a21=(a21+a02);
  a01=(a01*a21);
  a01=casadi_fabs(a01);
  a20=(a20+a01);
  a00=casadi_fmax(a00,a20);
  a20=-4.6948356807511743e+01;
  a23=(a20*a23);
  a23=casadi_fabs(a23);
  a20=(a20*a21);
  a21=4.6948356807511743e+01;
  a01=-1.8779342723004693e+08;
  a02=4.9999999999999994e-01;
  a02=(a02/a11);
  a07=arg[0]? arg[0][19] : 0;
  a22=(a06*a07);
  a10=casadi_fmax(a22,a09);
  a13=casadi_sq(a10);
  a13=(a05*a13);
  a12=(a12*a10);
  a13=(a13-a12);
  a04=(a04+a13);
  a13=(a03/a04);
  a12=(a02+a13);
  a19=(a01/a12);
  a01=(a01*a18);
  a18=1.8779342723004693e+08;
  a16=(a18*a07);
  a01=(a01+a16);
  a01=(a01/a12);
  a01=(a01/a12);
  a02=(a02/a11);
  a02=(a02*a15);
  a02=(a01*a02);
  a19=(a19+a02);
  a02=(a21*a19);
  a20=(a20+a02);
  a20=casadi_fabs(a20);
  a23=(a23+a20);
  a18=(a18/a12);
  a13=(a13/a04);
  a10=(2.*a10);
  a12=(a09<=a22);
  a22=(a22<=a09);
  a22=(a12+a22);
  a12=(a12/a22);
  a06=(a06*a12);
  a10=(a10*a06);
  a05=(a05*a10);
  a08=(a08*a12);
  a05=(a05-a08);
  a13=(a13*a05);
  a01=(a01*a13);
  a18=(a18+a01);
  a21=(a21*a18);
  a21=casadi_fabs(a21);
  a23=(a23+a21);
  a00=casadi_fmax(a00,a23);
  a23=-4.6948356807511729e+01;
  a19=(a23*a19);
  a19=casadi_fabs(a19);
  a23=(a23*a18);
  a18=4.6948356807511729e+01;
  a21=-2.4024024024024028e+08;
  a01=6.3963963963963955e-01;
  a01=(a01/a04);
  a13=3.6036036036036045e-01;
  a08=-1.5666130553560444e-10;
  a12=-2.8335654481285585e-17;
  a10=2.1276595744680849e+03;
  a06=arg[0]? arg[0][20] : 0;
  a22=(a10*a06);
  a20=casadi_fmax(a22,a09);
  a02=casadi_sq(a20);
  a02=(a12*a02);
  a15=-1.2798410234212686e-13;
  a15=(a15*a20);
  a02=(a02-a15);
  a08=(a08+a02);
  a13=(a13/a08);
  a02=(a01+a13);
  a15=(a21/a02);
  a21=(a21*a07);
  a07=1.2778736182991502e+08;
  a11=(a07*a06);
  a21=(a21+a11);
  a21=(a21/a02);
  a21=(a21/a02);
  a01=(a01/a04);
  a01=(a01*a05);
  a01=(a21*a01);
  a15=(a15+a01);
  a01=(a18*a15);
  a23=(a23+a01);
  a23=casadi_fabs(a23);
  a19=(a19+a23);
  a07=(a07/a02);
  a13=(a13/a08);
  a20=(2.*a20);
  a02=(a09<=a22);
  a22=(a22<=a09);
  a22=(a02+a22);
  a02=(a02/a22);
  a10=(a10*a02);
  a20=(a20*a10);
  a12=(a12*a20);
  a20=-2.7230660072792945e-10;
  a20=(a20*a02);
  a12=(a12-a20);
  a13=(a13*a12);
  a21=(a21*a13);
  a07=(a07+a21);
  a18=(a18*a07);
  a18=casadi_fabs(a18);
  a19=(a19+a18);
  a00=casadi_fmax(a00,a19);
  a19=-8.3333333333333286e+01;
  a15=(a19*a15);
  a15=casadi_fabs(a15);
  a19=(a19*a07);
  a07=8.3333333333333286e+01;
  a18=-1.3771259381670445e+08;
  a21=3.8834951456310696e-01;
  a21=(a21/a08);
  a13=6.1165048543689304e-01;
  a20=-9.4271879360788195e-11;
  a02=-1.7051149878625489e-17;
  a10=2.9850746268656712e+03;
  a22=arg[0]? arg[0][21] : 0;
  a23=(a10*a22);
  a01=casadi_fmax(a23,a09);
  a05=casadi_sq(a01);
  a05=(a02*a05);
  a04=-7.7015200497953656e-14;
  a11=(a04*a01);
  a05=(a05-a11);
  a05=(a20+a05);
  a13=(a13/a05);
  a11=(a21+a13);
  a16=(a18/a11);
  a18=(a18*a06);
  a06=1.9320871371298832e+08;
  a17=(a06*a22);
  a18=(a18+a17);
  a18=(a18/a11);
  a18=(a18/a11);
  a21=(a21/a08);
  a21=(a21*a12);
  a21=(a18*a21);
  a16=(a16+a21);
  a21=(a07*a16);
  a19=(a19+a21);
  a19=casadi_fabs(a19);
  a15=(a15+a19);
  a06=(a06/a11);
  a13=(a13/a05);
  a01=(2.*a01);
  a11=(a09<=a23);
  a23=(a23<=a09);
  a23=(a11+a23);
  a11=(a11/a23);
  a23=(a10*a11);
  a01=(a01*a23);
  a01=(a02*a01);
  a23=-2.2989612088941387e-10;
  a11=(a23*a11);
  a01=(a01-a11);
  a13=(a13*a01);
  a18=(a18*a13);
  a06=(a06+a18);
  a07=(a07*a06);
  a07=casadi_fabs(a07);
  a15=(a15+a07);
  a00=casadi_fmax(a00,a15);
  a15=-5.2910052910052919e+01;
  a16=(a15*a16);
  a16=casadi_fabs(a16);
  a06=(a15*a06);
  a07=5.2910052910052919e+01;
  a18=-1.5794045644791925e+08;
  a13=(a03/a05);
  a11=arg[0]? arg[0][22] : 0;
  a19=(a10*a11);
  a21=casadi_fmax(a19,a09);
  a12=casadi_sq(a21);
  a12=(a02*a12);
  a08=(a04*a21);
  a12=(a12-a08);
  a12=(a20+a12);
  a08=(a03/a12);
  a17=(a13+a08);
  a14=(a18/a17);
  a18=(a18*a22);
  a22=1.5794045644791925e+08;
  a24=(a22*a11);
  a18=(a18+a24);
  a18=(a18/a17);
  a18=(a18/a17);
  a13=(a13/a05);
  a13=(a13*a01);
  a13=(a18*a13);
  a14=(a14+a13);
  a13=(a07*a14);
  a06=(a06+a13);
  a06=casadi_fabs(a06);
  a16=(a16+a06);
  a22=(a22/a17);
  a12=(a08/a12);
  a21=(2.*a21);
  a17=(a09<=a19);
  a19=(a19<=a09);
  a19=(a17+a19);
  a17=(a17/a19);
  a19=(a10*a17);
  a21=(a21*a19);
  a21=(a02*a21);
  a17=(a23*a17);
  a21=(a21-a17);
  a12=(a12*a21);
  a18=(a18*a12);
  a22=(a22+a18);
  a18=(a07*a22);
  a18=casadi_fabs(a18);
  a16=(a16+a18);
  a00=casadi_fmax(a00,a16);
  a14=(a15*a14);
  a14=casadi_fabs(a14);
  a22=(a15*a22);
  a16=-1.5794045644791889e+08;
  a18=arg[0]? arg[0][23] : 0;
  a21=(a10*a18);
  a17=casadi_fmax(a21,a09);
  a19=casadi_sq(a17);
  a19=(a02*a19);
  a06=(a04*a17);
  a19=(a19-a06);
  a19=(a20+a19);
  a06=(a03/a19);
  a08=(a08+a06);
  a13=(a16/a08);
  a16=(a16*a11);
  a11=1.5794045644791889e+08;
  a01=(a11*a18);
  a16=(a16+a01);
  a16=(a16/a08);
  a16=(a16/a08);
  a12=(a16*a12);
  a13=(a13+a12);
  a12=(a07*a13);
  a22=(a22+a12);
  a22=casadi_fabs(a22);
  a14=(a14+a22);
  a11=(a11/a08);
  a19=(a06/a19);
  a17=(2.*a17);
  a08=(a09<=a21);
  a21=(a21<=a09);
  a21=(a08+a21);
  a08=(a08/a21);
  a21=(a10*a08);
  a17=(a17*a21);
  a17=(a02*a17);
  a08=(a23*a08);
  a17=(a17-a08);
  a19=(a19*a17);
  a16=(a16*a19);
  a11=(a11+a16);
  a16=(a07*a11);
  a16=casadi_fabs(a16);
  a14=(a14+a16);
  a00=casadi_fmax(a00,a14);
  a13=(a15*a13);
  a13=casadi_fabs(a13);
  a11=(a15*a11);
  a14=-1.5794045644791934e+08;
  a16=arg[0]? arg[0][24] : 0;
  a17=(a10*a16);
  a08=casadi_fmax(a17,a09);
  a21=casadi_sq(a08);
  a21=(a02*a21);
  a04=(a04*a08);
  a21=(a21-a04);
  a20=(a20+a21);
  a03=(a03/a20);
  a06=(a06+a03);
  a21=(a14/a06);
  a14=(a14*a18);
  a18=1.5794045644791934e+08;
  a16=(a18*a16);
  a14=(a14+a16);
  a14=(a14/a06);
  a14=(a14/a06);
  a19=(a14*a19);
  a21=(a21+a19);
  a19=(a07*a21);
  a11=(a11+a19);
  a11=casadi_fabs(a11);
  a13=(a13+a11);
  a18=(a18/a06);
  a03=(a03/a20);
  a08=(2.*a08);
  a20=(a09<=a17);
  a17=(a17<=a09);
  a17=(a20+a17);
  a20=(a20/a17);
  a10=(a10*a20);
  a08=(a08*a10);
  a02=(a02*a08);
  a23=(a23*a20);
  a02=(a02-a23);
  a03=(a03*a02);
  a14=(a14*a03);
  a18=(a18+a14);
  a07=(a07*a18);
  a07=casadi_fabs(a07);
  a13=(a13+a07);
  a00=casadi_fmax(a00,a13);
  a21=(a15*a21);
  a21=casadi_fabs(a21);
  a15=(a15*a18);
  a15=casadi_fabs(a15);
  a21=(a21+a15);
  a00=casadi_fmax(a00,a21);
  if (res[0]!=0) res[0][0]=a00;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_radius(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f3(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int cell_radius_checkout(void) {
  return 0;
}

CASADI_SYMBOL_EXPORT void cell_radius_release(int mem) {
}

CASADI_SYMBOL_EXPORT void cell_radius_incref(void) {
}

CASADI_SYMBOL_EXPORT void cell_radius_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int cell_radius_n_in(void) { return 2;}

CASADI_SYMBOL_EXPORT casadi_int cell_radius_n_out(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_real cell_radius_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_radius_name_in(casadi_int i) {
  switch (i) {
    case 0: return "i0";
    case 1: return "i1";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const char* cell_radius_name_out(casadi_int i) {
  switch (i) {
    case 0: return "o0";
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_radius_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s1;
    case 1: return casadi_s0;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT const casadi_int* cell_radius_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s3;
    default: return 0;
  }
}

CASADI_SYMBOL_EXPORT int cell_radius_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

CASADI_SYMBOL_EXPORT int cell_radius_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}


