package leaprig;

/** The robot as the session sees it: joints in rad, Nm, N, poses x y z [mm] A B C [rad]. What fails is thrown. */
interface Arm {
    void joints(double[] into);

    double[] measuredTorques();

    double[] externalTorques();

    double[] pose();

    double[] force();

    double[] moment();

    /** Attaches the tool; returns the mass and centre that the controller then reckons with. */
    double[] attach(ToolData tool);

    /** Whether the controller's check of mass and torques lets it be soft here. */
    boolean mayBeSoft();

    /** Starts a motion and returns at once. */
    void start(Motion motion);

    /** Whether the motion has ended and the arm stands. */
    boolean finished();

    /** Ends the motion with the controller's own deceleration; returns at once. */
    void cancel();

    /** What condition broke the motion, in words, or null. */
    String broken();

    /** Why the controller gave the motion up, or null. */
    String error();

    void startServo(Soft soft);

    void servo(double[] joints);

    void servoPose(double[] pose);

    void stopServo();

    String operationMode();

    String enabling();

    /** The safety stop that is active, or `NOSTOP`. */
    String safetyStop();
}
