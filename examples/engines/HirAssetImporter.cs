// Light and specular of exported assets in Unity 6 with glTFast 6.9; goes into Assets/Editor. Not run by hir's tests: docs/engines/unity.md.
// The .glb of profile `unity-legacy` carries specular-glossiness, which glTFast turns into a material of the specular workflow by itself.
using UnityEditor;
using UnityEngine;
using UnityEngine.Rendering;

namespace Hir
{
    /// Imports .hdr files as uncompressed panoramas, their pixels as they are.
    public sealed class HirLightImporter : AssetPostprocessor
    {
        void OnPreprocessTexture()
        {
            if (!assetPath.EndsWith(".hdr")) return;
            var importer = (TextureImporter)assetImporter;
            importer.textureShape = TextureImporterShape.Texture2D; // Skybox/Panoramic samples the panorama itself
            importer.sRGBTexture = false;
            importer.mipmapEnabled = false;
            importer.wrapModeU = TextureWrapMode.Repeat;
            importer.wrapModeV = TextureWrapMode.Clamp;
            importer.textureCompression = TextureImporterCompression.Uncompressed;
            importer.npotScale = TextureImporterNPOTScale.None;
        }
    }

    public static class HirLight
    {
        // glTFast turns the file's +X to Unity's -X. Skybox/Panoramic has Unity's +X in its middle, the image +Z: a quarter turn.
        const float Rotation = 90f;

        [MenuItem("hir/Light the scene with the selected .hdr")]
        static void Apply()
        {
            var panorama = Selection.activeObject as Texture2D;
            if (panorama == null)
            {
                EditorUtility.DisplayDialog("hir", "Select an imported .hdr first.", "OK");
                return;
            }
            var sky = new Material(Shader.Find("Skybox/Panoramic"));
            sky.SetTexture("_MainTex", panorama);
            sky.SetFloat("_Mapping", 1f);   // latitude longitude
            sky.SetFloat("_ImageType", 0f); // 360 degrees
            sky.SetFloat("_Rotation", Rotation);
            sky.SetFloat("_Exposure", 1f);
            AssetDatabase.CreateAsset(sky, AssetDatabase.GenerateUniqueAssetPath(
                System.IO.Path.ChangeExtension(AssetDatabase.GetAssetPath(panorama), ".sky.mat")));
            RenderSettings.skybox = sky;
            RenderSettings.ambientMode = AmbientMode.Skybox;
            RenderSettings.ambientIntensity = 1f;
            RenderSettings.defaultReflectionMode = DefaultReflectionMode.Skybox;
            RenderSettings.reflectionIntensity = 1f;
            DynamicGI.UpdateEnvironment();
        }
    }
}
